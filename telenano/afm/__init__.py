"""The AFM as steps without a clock: contact, cantilever, sample, disturbances, guard and programs."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.afm.contact.maugis_dugdale import MaugisDugdale as MaugisDugdale
    from telenano.afm.contact.maugis_dugdale import cohesive_stress_pa as cohesive_stress_pa
    from telenano.afm.contact.maugis_dugdale import force_n as force_n
    from telenano.afm.contact.maugis_dugdale import reduced_modulus_pa as reduced_modulus_pa
    from telenano.afm.contact.tip_sample import branch_force as branch_force
    from telenano.afm.disturbances import noise_start as noise_start
    from telenano.afm.disturbances import noise_step as noise_step
    from telenano.afm.disturbed import piezo_params as piezo_params
    from telenano.afm.dynamic import damping_at as damping_at
    from telenano.afm.dynamic_sim import settled_tip as settled_tip
    from telenano.afm.felt import ChannelName as ChannelName
    from telenano.afm.layers import Ground as Ground
    from telenano.afm.layers import Height as Height
    from telenano.afm.layers import Layer as Layer
    from telenano.afm.part import Part as Part
    from telenano.afm.part import inputs_over as inputs_over
    from telenano.afm.part import part_start as part_start
    from telenano.afm.part import part_step as part_step
    from telenano.afm.part import register_part as register_part
    from telenano.afm.safety import MODE_HOLD as MODE_HOLD
    from telenano.afm.safety import MODE_RETRACTING as MODE_RETRACTING
    from telenano.afm.sample.surface import SHAPES as SHAPES
    from telenano.afm.sample.surface import height_over_middle as height_over_middle
    from telenano.afm.sim import simulated_afm as simulated_afm
    from telenano.afm.standalone_guard import TipGuard as TipGuard
else:
    __getattr__, __dir__ = face(
        __name__,
        {
            "telenano.settings": ("CurveSettings", "DisturbanceConfig", "ScanSettings"),
            "telenano.sections": ("AfmConfig", "AfmControllerConfig", "SAMPLES", "SampleConfig", "read_surface"),
        },
    )

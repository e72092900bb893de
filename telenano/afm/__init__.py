"""The AFM as steps without a clock: contact, cantilever, sample, disturbances, guard, programs and their settings."""

from typing import TYPE_CHECKING

from telenano.faces import face

if TYPE_CHECKING:
    from telenano.afm.config import AfmConfig as AfmConfig
    from telenano.afm.contact.maugis_dugdale import reduced_modulus_pa as reduced_modulus_pa
    from telenano.afm.layers import Ground as Ground
    from telenano.afm.layers import Height as Height
    from telenano.afm.layers import Layer as Layer
    from telenano.afm.layers import Said as Said
    from telenano.afm.part import AfmSample as AfmSample
    from telenano.afm.part import Part as Part
    from telenano.afm.part import PlantInputs as PlantInputs
    from telenano.afm.part import inputs_over as inputs_over
    from telenano.afm.part import motion_around as motion_around
    from telenano.afm.part import part_start as part_start
    from telenano.afm.part import part_step as part_step
    from telenano.afm.part import register_part as register_part
    from telenano.afm.part import truths_of as truths_of
    from telenano.afm.programs.runner import Report as Report
    from telenano.afm.programs.settings import requested as requested
    from telenano.afm.sample.surface import Surface as Surface
    from telenano.afm.sample.surface import height_over_middle as height_over_middle
    from telenano.afm.sample.surface_files import read_surface as read_surface
else:
    __getattr__, __dir__ = face(__name__)

"""Settings of AFM, hand and controller: the sections of a scenario, with the files and packages that they name.

Each section builds the parameters of the pure steps in `telenano.afm`, `telenano.hand` and `telenano.laws`.
"""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.sections.afm_parts import AfmControllerConfig as AfmControllerConfig
    from telenano.sections.afm_section import SAMPLES as SAMPLES
    from telenano.sections.afm_section import AfmConfig as AfmConfig
    from telenano.sections.controller_section import LAWS as LAWS
    from telenano.sections.controller_section import OWN_LAWS as OWN_LAWS
    from telenano.sections.controller_section import ControllerConfig as ControllerConfig
    from telenano.sections.controller_section import changed_config as changed_config
    from telenano.sections.controller_section import late_periods as late_periods
    from telenano.sections.hand_section import HapticConfig as HapticConfig
    from telenano.sections.hand_section import LimitsConfig as LimitsConfig
    from telenano.sections.lateral_hand_section import LateralPath as LateralPath
    from telenano.sections.operator_section import ARMS as ARMS
    from telenano.sections.own_laws import VIRTUAL_IMPEDANCE as VIRTUAL_IMPEDANCE
    from telenano.sections.own_laws import ImpedanceConfig as ImpedanceConfig
    from telenano.sections.own_laws import VirtualImpedanceConfig as VirtualImpedanceConfig
    from telenano.sections.sample_section import SampleConfig as SampleConfig
    from telenano.sections.surface_files import read_surface as read_surface
else:
    __getattr__, __dir__ = face(__name__)

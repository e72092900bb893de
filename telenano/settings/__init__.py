"""Settings: models, scenarios, sites and instruments, and the loaders of the packages that settings name."""

from typing import TYPE_CHECKING

from telenano.lazy_exports import face

if TYPE_CHECKING:
    from telenano.settings.afm_disturbances import DisturbanceConfig as DisturbanceConfig
    from telenano.settings.config import Settings as Settings
    from telenano.settings.config import flag_overrides as flag_overrides
    from telenano.settings.config import flatten as flatten
    from telenano.settings.config import merge as merge
    from telenano.settings.config import nested as nested
    from telenano.settings.config import permit_code as permit_code
    from telenano.settings.config import read_yaml as read_yaml
    from telenano.settings.config import refused_code as refused_code
    from telenano.settings.config import section_of as section_of
    from telenano.settings.config import validate as validate
    from telenano.settings.device_drivers import DeviceDriver as DeviceDriver
    from telenano.settings.file_readers import FileReader as FileReader
    from telenano.settings.file_readers import read_by_package as read_by_package
    from telenano.settings.included import DEFAULT_SITE_FILE as DEFAULT_SITE_FILE
    from telenano.settings.included import DEMO_RECORDING as DEMO_RECORDING
    from telenano.settings.included import TWO_SITES_FILE as TWO_SITES_FILE
    from telenano.settings.included import anchored as anchored
    from telenano.settings.included import find_scenario as find_scenario
    from telenano.settings.link_settings import LinkSettings as LinkSettings
    from telenano.settings.named_instruments import instrument_named as instrument_named
    from telenano.settings.network_profiles import Profile as Profile
    from telenano.settings.network_profiles import profile_named as profile_named
    from telenano.settings.option import Option as Option
    from telenano.settings.plugins import code_of as code_of
    from telenano.settings.plugins import fault_of_package as fault_of_package
    from telenano.settings.plugins import installed as installed
    from telenano.settings.plugins import load as load
    from telenano.settings.program_settings import CurveSettings as CurveSettings
    from telenano.settings.program_settings import ScanSettings as ScanSettings
    from telenano.settings.scenario import LoadedScenario as LoadedScenario
    from telenano.settings.scenario import Scenario as Scenario
else:
    __getattr__, __dir__ = face(__name__)

"""The sites, scenarios and networks that come with the project, and the way from a name to their files."""

from pathlib import Path
from typing import TYPE_CHECKING

from telenano.faces import face
from telenano.settings.plugins import scenario_files
from telenano.wire.errors import ConfigError, probably_meant

if TYPE_CHECKING:
    from telenano.settings.config import Settings as Settings
    from telenano.settings.config import flag_overrides as flag_overrides
    from telenano.settings.config import flatten as flatten
    from telenano.settings.config import merge as merge
    from telenano.settings.config import nested as nested
    from telenano.settings.config import parse_yaml as parse_yaml
    from telenano.settings.config import read_yaml as read_yaml
    from telenano.settings.config import refused_code as refused_code
    from telenano.settings.config import section_of as section_of
    from telenano.settings.config import validate as validate
    from telenano.settings.device_drivers import DeviceDriver as DeviceDriver
    from telenano.settings.device_drivers import haptic_driver as haptic_driver
    from telenano.settings.file_readers import FileReader as FileReader
    from telenano.settings.file_readers import read_by_package as read_by_package
    from telenano.settings.known_packages import where_it_is as where_it_is
    from telenano.settings.named_instruments import instrument_named as instrument_named
    from telenano.settings.option import Option as Option
    from telenano.settings.plugins import all_installed as all_installed
    from telenano.settings.plugins import fault_of_package as fault_of_package
    from telenano.settings.plugins import load as load
    from telenano.settings.scenario import RealtimeConfig as RealtimeConfig
    from telenano.settings.scenario import load_scenario as load_scenario
    from telenano.settings.scenario import scenario_of as scenario_of
else:
    __getattr__, __dir__ = face(__name__)

_FOLDER = Path(__file__).resolve().parent
SITE_DIRECTORY = _FOLDER / "sites"
SCENARIO_DIRECTORY = _FOLDER / "scenarios"
NETWORK_DIRECTORY = _FOLDER / "networks"
SCHEMA_DIRECTORY = _FOLDER / "schemas"
DEFAULT_SITE_FILE = SITE_DIRECTORY / "local.yaml"
TWO_SITES_FILE = SITE_DIRECTORY / "two_sites.yaml"
# a session of Fig. 12, for who wants to see one before anything runs
DEMO_RECORDING = _FOLDER / "demo.mcap"


def scenarios() -> dict[str, Path]:
    """Return the files of the scenarios that come with the project and with installed packages, by name."""
    own = {path.stem: path for path in sorted(SCENARIO_DIRECTORY.glob("*.yaml"))}
    return {**scenario_files().found, **own}


def known_scenarios() -> list[str]:
    """Return the names of the scenarios that come with the project and with installed packages."""
    return sorted(scenarios())


def find_scenario(name: str) -> Path:
    """Return the file of a scenario named or given as a path; ConfigError lists the names known."""
    own = SCENARIO_DIRECTORY / f"{name}.yaml"
    if "/" not in name and own.is_file():
        return own
    packages = scenario_files()
    if name in packages.problems:
        raise ConfigError(packages.problems[name])
    path = packages.found.get(name, Path(name))
    if path.suffix in (".yaml", ".yml") or path.exists():
        return path
    from telenano.settings.known_packages import where_it_is

    if hint := where_it_is(f"scenario {name}"):
        raise ConfigError(hint)
    names = known_scenarios()
    listed = f"known are {', '.join(names)}, or give a .yaml file{probably_meant(name, names)}"
    raise ConfigError(f"unknown scenario {name!r}: {listed}")


def site_file_named(given: Path | None) -> Path | None:
    """Return the file of a site that comes with the project by its name, such as two_sites; a path stays as it is."""
    if given is None or given.suffix or given.exists():
        return given
    packaged = SITE_DIRECTORY / f"{given}.yaml"
    return packaged if packaged.is_file() else given

"""Sites, scenarios and networks that come with the project, and the search for their files by name.

find_scenario("fig12")                     # .../telenano/settings/scenarios/fig12.yaml
site_file_named(Path("two_sites"))         # .../telenano/settings/sites/two_sites.yaml
"""

import os
from pathlib import Path
from typing import Any

from telenano.settings.plugins import scenario_files
from telenano.wire.errors import ConfigError, known_names, probably_meant

_FOLDER = Path(__file__).resolve().parent
SITE_DIRECTORY = _FOLDER / "sites"
SCENARIO_DIRECTORY = _FOLDER / "scenarios"
NETWORK_DIRECTORY = _FOLDER / "networks"
SCHEMA_DIRECTORY = _FOLDER / "schemas"
DEFAULT_SITE_FILE = SITE_DIRECTORY / "local.yaml"
TWO_SITES_FILE = SITE_DIRECTORY / "two_sites.yaml"
# A recorded session of Fig. 12, to look at before anything runs.
DEMO_RECORDING = _FOLDER / "demo.mcap"


def scenarios() -> dict[str, Path]:
    """Return the files of the scenarios that come with the project and with installed packages, by name."""
    own = {path.stem: path for path in sorted(SCENARIO_DIRECTORY.glob("*.yaml"))}
    return {**scenario_files().found, **own}


def known_scenarios() -> list[str]:
    """Return the names of the scenarios that come with the project and with installed packages."""
    return sorted(scenarios())


def name_of_scenario(path: Path) -> str:
    """Return what an error calls a scenario: its name if it comes with the project, otherwise its path."""
    return path.stem if path.parent == SCENARIO_DIRECTORY else str(path)


def find_scenario(name: str | os.PathLike[str]) -> Path:
    """Return the file of a scenario named or given as a path; ConfigError lists the names known."""
    if not isinstance(name, str | os.PathLike):
        raise ConfigError(f"a scenario is a name such as fig12, or the path of a .yaml file, and not {name!r}")
    name = os.fspath(name)
    if not name or "\0" in name:
        raise ConfigError("the name of the scenario is empty" if not name else f"{name}: can be no name of a file")
    own = SCENARIO_DIRECTORY / f"{name}.yaml"
    # `Path.is_file` and `Path.exists` raise for a name that is too long.
    if "/" not in name and os.path.isfile(own):  # noqa: PTH113
        return own
    packages = scenario_files()
    if name in packages.problems:
        raise ConfigError(packages.problems[name])
    path = packages.found.get(name, Path(name))
    is_session = path.suffix != ".yaml" and os.path.isdir(path) and any(path.glob("*.mcap"))  # noqa: PTH112
    if path.suffix == ".mcap" or is_session:
        raise ConfigError(
            f"{name}: is the {'folder' if is_session else 'name'} of a recording, not of a scenario: `telenano view`"
            " shows it, `telenano report` makes its figure, `telenano replay` sends it into a rig"
        )
    # A suffix alone does not make the name that of a file.
    if path.suffix in (".yaml", ".yml") and "/" not in name and not os.path.exists(path):  # noqa: PTH110
        names = known_scenarios()
        if meant := f"; did you mean {path.stem}?" if path.stem in names else probably_meant(path.stem, names):
            raise ConfigError(f"{path.absolute()}: cannot be read: No such file or directory{meant}")
    if path.suffix in (".yaml", ".yml") or os.path.exists(path):  # noqa: PTH110
        return path
    from telenano.settings.known_packages import where_it_is

    if hint := where_it_is(f"scenario {name}"):
        raise ConfigError(hint)
    names = known_scenarios()
    raise ConfigError(f"unknown scenario {name!r}: {known_names(name, names)}, or give a .yaml file")


def site_file_named(path: Path | None) -> Path | None:
    """Return the file of a site that comes with the project by its name, such as two_sites; a path stays as it is."""
    if path is None or path.suffix or os.path.exists(path):  # noqa: PTH110
        return path
    packaged = SITE_DIRECTORY / f"{path}.yaml"
    # `Path.is_file` raises for a name that is too long.
    return packaged if os.path.isfile(packaged) else path  # noqa: PTH113


def anchored(tree: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return a scenario with absolute file names.

    A file that does not exist in `folder`, that of the scenario, but in the working directory is taken from there. So
    are missing files if `folder` is that of the packaged scenarios.
    """
    return {key: _anchored_value(key, value, folder) for key, value in tree.items()}


def _anchored_value(key: str, value: Any, folder: Path) -> Any:
    if isinstance(value, dict):
        return anchored(value, folder)
    if not isinstance(value, str) or not (key == "file" or key.endswith("_file")):
        return value
    beside, here = folder / value, Path(value).absolute()
    return str(here if (here.exists() or folder == SCENARIO_DIRECTORY) and not beside.exists() else beside)

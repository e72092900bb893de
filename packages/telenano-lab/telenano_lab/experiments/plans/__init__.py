"""The experiments that come with this package, and the way from a name to their files."""

from pathlib import Path

from telenano.wire import ConfigError, known_names

FOLDER = Path(__file__).resolve().parent


def find_experiment(name: str) -> Path:
    """Return the file of an experiment that comes with the package or is given as a path; ConfigError lists names."""
    own = FOLDER / f"{name}.yaml"
    if "/" not in name and own.is_file():
        return own
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or path.exists():
        return path
    names = sorted(file.stem for file in FOLDER.glob("*.yaml"))
    raise ConfigError(f"unknown experiment {name!r}: {known_names(name, names)}; or give a .yaml file")

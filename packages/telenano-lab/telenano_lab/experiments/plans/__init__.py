"""The experiments that come with this package, and their lookup by name."""

import os
from pathlib import Path

from telenano.wire import ConfigError, known_names

FOLDER = Path(__file__).resolve().parent


def find_experiment(name: str) -> Path:
    """Return the file of an experiment, given the name of one in the package or a path; ConfigError lists the names."""
    own = FOLDER / f"{name}.yaml"
    # `Path.is_file` and `Path.exists` raise for a name that is too long.
    if "/" not in name and os.path.isfile(own):  # noqa: PTH113
        return own
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or os.path.exists(path):  # noqa: PTH110
        return path
    names = sorted(file.stem for file in FOLDER.glob("*.yaml"))
    raise ConfigError(f"unknown experiment {name!r}: {known_names(name, names)}; or give a .yaml file")

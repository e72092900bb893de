"""Named instruments: the disturbances of an AFM as keys of a scenario, each with its source.

    scenario: fig12             telenano up fig12 --instrument real
    instrument: real            telenano.simulate("fig12", instrument="real")

An instrument is a file of `telenano/settings/instruments` and is named after it. Keys of the scenario and of `--set`
override the keys of its instrument, as keys of a link override those of its profile. The environment variable
TELENANO_INSTRUMENTS names a folder with further instruments.
"""

import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import Field

from telenano.files.held_files import listed
from telenano.settings.config import Settings, flatten, merge, read_yaml, validate
from telenano.wire.errors import ConfigError, known_names

IDEAL = "ideal"
_FOLDER = Path(__file__).resolve().parent / "instruments"
# An instrument may set these sections only, so that it cannot change what is measured with it.
_SECTIONS = ("afm_node.disturbances.", "haptic_node.disturbances.")


class Source(Settings):
    """A publication with the figures taken from it."""

    cite: str = Field(min_length=1, description="Paper, or manual with its place")
    taken: str = Field(min_length=1, description="The figures taken from it, and the values made of them")


class Instrument(Settings):
    """A named instrument."""

    about: str = Field(min_length=1, description="The instrument in one line")
    source: tuple[Source, ...] = Field(default=(), description="Published figures")
    assumed: tuple[str, ...] = Field(default=(), description="Values that no source states, and the choices made")
    scenario: dict[str, Any] = Field(default={}, description="Keys of a scenario, below the scenario's own")


def instrument_names() -> list[str]:
    """Return the names of the instruments that come with the project and of those of the environment."""
    return list(_files())


@cache
def instrument_named(name: str) -> Instrument:
    """Return an instrument.

    Raises:
        ConfigError: No instrument has this name, or its file is wrong; the message names the file and the key.
    """
    if name not in _files():
        path = Path(name)
        if path.suffix in (".yaml", ".yml"):
            raise ConfigError(
                f"instrument: {name} is a file: set TELENANO_INSTRUMENTS={path.parent} and name it as {path.stem}"
            )
        raise ConfigError(f"instrument: unknown instrument {name!r}; {known_names(name, _files())}")
    path = _files()[name]
    instrument = validate(Instrument, read_yaml(path), str(path))
    for key in flatten(instrument.scenario):
        if not key.startswith(_SECTIONS):
            raise ConfigError(f"{path}: scenario.{key}: an instrument sets keys of {' and '.join(_SECTIONS)} alone")
    return instrument


def on_instrument(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a scenario merged over the keys of the instrument that it names; merging again changes nothing.

    Raises:
        ConfigError: There is no such instrument, or its file is wrong.
    """
    name = document.get("instrument", IDEAL)
    # A name that is not text is refused when the whole scenario is validated.
    return merge(instrument_named(name).scenario, document) if isinstance(name, str) else dict(document)


def _files() -> dict[str, Path]:
    """Return the files by name; a file of the project overrides one of the same name in the environment's folder."""
    folders = [Path(folder) for folder in (os.environ.get("TELENANO_INSTRUMENTS"), _FOLDER) if folder]
    return {path.stem: path for folder in folders for path in listed(folder, ".yaml")}

"""Named instruments: keys of a scenario that say what disturbs an AFM, each with its source.

    scenario: fig12             telenano up fig12 --instrument real
    instrument: real            telenano.simulate("fig12", instrument="real")

An instrument is a file of `telenano/settings/instruments`, and its name is that of the file. The keys of a scenario
that names it, and those of `--set`, stand over its own, as the keys of a link stand over those of its profile. The
environment variable TELENANO_INSTRUMENTS names a folder of further ones.
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
# What an instrument may set, so that it cannot change what is measured with it.
_SECTIONS = ("afm_node.disturbances.", "haptic_node.disturbances.")


class Source(Settings):
    """Where figures were published, and which of them were taken."""

    cite: str = Field(min_length=1, description="Paper, or manual with its place")
    taken: str = Field(min_length=1, description="The figures taken from it, and what was made of them")


class Instrument(Settings):
    """A named instrument."""

    about: str = Field(min_length=1, description="What it is, in one line")
    source: tuple[Source, ...] = Field(default=(), description="Published figures")
    assumed: tuple[str, ...] = Field(default=(), description="What no source says, and what was chosen")
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
    """Return a scenario over the keys of the instrument that it names; doing so again changes nothing.

    Raises:
        ConfigError: There is no such instrument, or its file is wrong.
    """
    name = document.get("instrument", IDEAL)
    # What is no text is refused with the rest of the scenario.
    return merge(instrument_named(name).scenario, document) if isinstance(name, str) else dict(document)


def _files() -> dict[str, Path]:
    """Return the files by name, those of the project first."""
    folders = [Path(folder) for folder in (os.environ.get("TELENANO_INSTRUMENTS"), _FOLDER) if folder]
    return {path.stem: path for folder in folders for path in listed(folder, ".yaml")}

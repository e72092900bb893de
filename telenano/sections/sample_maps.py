"""Recorded maps under the tip, read by packages (entry points `telenano.maps`) that are chosen by the file's suffix.

The entry `npz` reads files `*.npz`. A recorded map replaces the model of the force: the package provides the step, and
it gives the extent of the map without reading its values, so that the guard can keep the base within it.
"""

from functools import cache
from pathlib import Path
from typing import Any

from telenano.afm.part import Part, register_part
from telenano.extend.maps import MapFormat, OverMap, Span
from telenano.files.held_files import standing
from telenano.settings import plugins
from telenano.settings.known_packages import where_it_is
from telenano.wire.errors import ConfigError


def _checked(name: str, value: Any) -> MapFormat:
    if not isinstance(value, MapFormat):
        raise TypeError(f"is a {type(value).__name__}, must be a MapFormat")
    register_part(value.params, Part(value.start, value.step))
    return value


@cache
def _format_of(suffix: str) -> tuple[MapFormat | None, str]:
    """Return the format of files with a suffix (without its dot), and the reason to give where there is none."""
    loaded = plugins.load("maps", _checked, only=suffix)
    names = ", ".join(f".{name}" for name in plugins.installed("maps")) or "none"
    absent = where_it_is(f"map {suffix}") or f"is of no format that is felt here; known are {names}"
    return loaded.found.get(suffix), loaded.problems.get(suffix, absent)


def _suffix(path: Path) -> str:
    return path.suffix.lower().removeprefix(".")


def span_of(path: Path) -> Span | None:
    """Return extent, stiffness and quantity of a map; None where its file or its package is not on this machine."""
    reader, _ = _format_of(_suffix(path))
    return None if reader is None else reader.span(standing(path))


def over_map(path: Path, rest_distance_m: float, stiffness_n_per_m: float, volts_per_m: float) -> OverMap:
    """Read a map as the parameters that an instrument steps over; `MapFormat` describes the arguments.

    Raises:
        ConfigError: The map cannot be used, or its package is missing; the message names it.
    """
    reader, problem = _format_of(_suffix(path))
    if reader is None:
        raise ConfigError(f"{path}: {problem}")
    return reader.read(standing(path), rest_distance_m, stiffness_n_per_m, volts_per_m)

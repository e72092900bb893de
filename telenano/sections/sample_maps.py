"""Recorded maps under the tip, read by packages (entry points `telenano.readers`) that are chosen by the file's suffix.

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
from telenano.settings.file_readers import checked_reader
from telenano.settings.known_packages import where_it_is
from telenano.wire.errors import ConfigError


def _checked(name: str, value: Any) -> MapFormat | None:
    """Return the map of a reader, registered as a part; None for files that hold none."""
    read = checked_reader(name, value).map
    if read is None:
        return None
    if not isinstance(read, MapFormat):
        raise TypeError(f"its map is a {type(read).__name__}, must be a MapFormat")
    register_part(read.params, Part(read.start, read.step))
    return read


@cache
def _format_of(name: str) -> tuple[MapFormat | None, str]:
    """Return the format of files that the reader of a name reads, and the reason to give where there is none."""
    loaded = plugins.load("readers", _checked, only=name)
    if name in loaded.found or name in loaded.problems:
        return loaded.found.get(name), loaded.problems.get(name, "")
    known = ", ".join(f".{other}" for other in plugins.load("readers", _checked).found) or "none"
    return None, where_it_is(f"map {name}") or f"is of no format that is felt here; known are {known}"


def span_of(path: Path) -> Span | None:
    """Return extent, stiffness and quantity of a map; None where its file or its package is not on this machine."""
    reader, _ = _format_of(plugins.name_of_ending(path))
    return None if reader is None else reader.span(standing(path))


def over_map(path: Path, rest_distance_m: float, stiffness_n_per_m: float, volts_per_m: float) -> OverMap:
    """Read a map as the parameters that an instrument steps over; `MapFormat` describes the arguments.

    Raises:
        ConfigError: The map cannot be used, or its package is missing; the message names it.
    """
    reader, problem = _format_of(plugins.name_of_ending(path))
    if reader is None:
        raise ConfigError(f"{path}: {problem}")
    return reader.read(standing(path), rest_distance_m, stiffness_n_per_m, volts_per_m)

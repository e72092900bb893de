"""Recorded maps under the tip, which packages read (entry points `telenano.maps`), by the end of the files' names.

The entry `npz` is for files `*.npz`. A map is felt in place of a model of the force: the package brings the step, and
says where the map is without reading its values, so that the guard keeps the base on it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from telenano.afm.part import Part, register
from telenano.settings import plugins
from telenano.settings.known_packages import where_it_is
from telenano.wire.errors import ConfigError


class Span(NamedTuple):
    """What a map says without its values: z from and to, half width, half depth [m], k [N/m] and quantity."""

    low_m: float
    high_m: float
    half_x_m: float
    half_y_m: float
    stiffness_n_per_m: float
    quantity: str


class OverMap(NamedTuple):
    """What an instrument steps over where a map lies under its tip.

    params: of the step; stiffness_n_per_m: of the cantilever that the map is felt through [N/m]; channel: what the map
    has in place of a force, empty for a force; about: the map in words.
    """

    params: Any
    stiffness_n_per_m: float
    channel: str
    about: str


@dataclass(frozen=True)
class MapFormat:
    """How a package feels the maps of a format.

    params: the class of the step's parameters, a NamedTuple; `start(params, inputs) -> state` of a tip that came from
    above, and `step(params, state, inputs, dt) -> (state, AfmSample)`, compiled, with inputs.base_m, x_m, y_m and
    height_m [m]. `span(path)` says where a map is without its values, None where the file cannot be read here.
    `read(path, rest_distance_m, stiffness_n_per_m, volts_per_m)` reads it, with the height of a base at 0 [m], the
    cantilever for a map that says none [N/m], and the gain of the read-out [V/m].

    Raises:
        ConfigError: `read` cannot use the file; the message names it.
    """

    params: type
    start: Callable[..., Any]
    step: Callable[..., Any]
    span: Callable[[Path], Span | None]
    read: Callable[[Path, float, float, float], OverMap]


def _checked(name: str, value: Any) -> MapFormat:
    if not isinstance(value, MapFormat):
        raise TypeError(f"is a {type(value).__name__}, must be a MapFormat")
    register(value.params, Part(value.start, value.step))
    return value


@cache
def _format_of(suffix: str) -> tuple[MapFormat | None, str]:
    """Return the format of files with that end, and why there is none."""
    loaded = plugins.load("maps", _checked, only=suffix)
    known = ", ".join(f".{name}" for name in plugins.installed("maps")) or "none"
    absent = where_it_is(f"map {suffix}") or f"is of no format that is felt here; known are {known}"
    return loaded.found.get(suffix), loaded.problems.get(suffix, absent)


def _suffix(path: Path) -> str:
    return path.suffix.lower().removeprefix(".")


def span_of(path: Path) -> Span | None:
    """Return where a map is; None where its file or its package is not on this machine."""
    found, _ = _format_of(_suffix(path))
    return None if found is None else found.span(path)


def over_map(path: Path, rest_distance_m: float, stiffness_n_per_m: float, volts_per_m: float) -> OverMap:
    """Return what an instrument steps over; see `MapFormat` for the arguments.

    Raises:
        ConfigError: The map cannot be used, or its package is missing; the message names it.
    """
    found, problem = _format_of(_suffix(path))
    if found is None:
        raise ConfigError(f"{path}: {problem}")
    return found.read(path, rest_distance_m, stiffness_n_per_m, volts_per_m)

"""Recorded maps of your own format under the tip: where a map is, the step over it, and the units of its values.

NPZ = MapFormat(MapParams, start, step, span_of, read_over_map)     # entry `npz` of `telenano.maps`
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
_PREFIXES = {"": 1.0, "k": 1e3, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9, "p": 1e-12, "f": 1e-15}
_QUANTITIES = {"N": "force", "Hz": "frequency_shift", "A": "current", "m": "amplitude", "rad": "phase"}
# A unit represents a quantity and a factor to its SI unit.
UNITS: dict[str, tuple[str, float]] = {
    **{prefix + unit: (name, scale) for unit, name in _QUANTITIES.items() for prefix, scale in _PREFIXES.items()},
    **{prefix + "V": ("voltage", scale) for prefix, scale in _PREFIXES.items()},
    "deg": ("phase", math.pi / 180.0),
}
SI_UNITS = {name: unit for unit, name in _QUANTITIES.items()}


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

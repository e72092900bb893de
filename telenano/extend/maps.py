"""Formats of recorded maps under the tip, for packages: extent of a map, the step over it, and units of its values.

NPZ = FileReader(map=MapFormat(MapParams, start, step, span_of, read))     # entry `npz` of `telenano.readers`
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
# Quantity and factor to its SI unit, by unit.
UNITS: dict[str, tuple[str, float]] = {
    **{prefix + unit: (name, scale) for unit, name in _QUANTITIES.items() for prefix, scale in _PREFIXES.items()},
    **{prefix + "V": ("voltage", scale) for prefix, scale in _PREFIXES.items()},
    "deg": ("phase", math.pi / 180.0),
}
SI_UNITS = {name: unit for unit, name in _QUANTITIES.items()}


class Span(NamedTuple):
    """Extent of a map: z from and to, half width, half depth [m], stiffness k [N/m], and quantity of its values."""

    low_m: float
    high_m: float
    half_x_m: float
    half_y_m: float
    stiffness_n_per_m: float
    quantity: str


class OverMap(NamedTuple):
    """A map as the sample of an instrument.

    params: parameters of the step; stiffness_n_per_m: stiffness of the cantilever with which the map is felt [N/m];
    channel: quantity of the map if it is not a force, else empty; about: description of the map.
    """

    params: Any
    stiffness_n_per_m: float
    channel: str
    about: str


@dataclass(frozen=True)
class MapFormat:
    """A format of maps and the step over them, from a package.

    params: the class of the step's parameters, a NamedTuple; `start(params, inputs) -> state` of a tip that came from
    above, and `step(params, state, inputs, dt) -> (state, AfmSample)`, compiled, with inputs.base_m, x_m, y_m and
    height_m [m]. `span(path)` returns the extent of a map without reading its values, None if the file cannot be read
    here. `read(path, rest_distance_m, stiffness_n_per_m, volts_per_m)` reads a map, given the height of a base at 0
    [m], the stiffness of the cantilever for a map without one [N/m], and the gain of the read-out [V/m].

    Raises:
        ConfigError: `read` cannot use the file; the message names it.
    """

    params: type
    start: Callable[..., Any]
    step: Callable[..., Any]
    span: Callable[[Path], Span | None]
    read: Callable[[Path, float, float, float], OverMap]

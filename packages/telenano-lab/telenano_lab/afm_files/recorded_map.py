"""A recorded map under the tip: values that an instrument measured over (x, y, z) replace a model of the force.

z is the height of the base, so a curve with snap-in and pull-off is felt as it was recorded. Between grid points the
value is a tricubic Catmull-Rom interpolation: a cubic Hermite along each axis whose slopes are central differences, and
at the outer points the slopes of the parabola through three points. It is C1, passes through every point, and uses 64
of them. An axis of one point is constant, one of two points is linear.

A map may have two branches, approach and retract. The tip changes to the retract branch only after it has made contact;
before, it goes back as it came. In contact a reversal blends from one branch to the other over `turn_m`, so that the
force does not jump. Above the contact an attached tip stays on the retract branch in both directions until the loop is
closed; there it is off the sample, and on the approach branch again.

The guard keeps the base on the map. If a disturbance moves it beyond, the outermost value applies.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.extend.samples import AfmSample, PlantInputs
from telenano.numerics import compiled

Array = npt.NDArray[np.float64]


class MapParams(NamedTuple):
    """A map and the cantilever through which it is felt; made by `force_map.map_params`.

    values: shape (branches, x, y, z), approach and then retract; low_m, step_m: first point and spacing of each axis
    [m], x and y relative to the middle of the map; onset_m, release_m: heights at which contact is made and the loop
    closes [m], shape (x, y); turn_m: see the module; rest_distance_m: height of a base at 0 [m]; stiffness_n_per_m,
    volts_per_m: of the cantilever; is_force: whether the values are forces [N], repulsive positive, rather than another
    channel.
    """

    values: Array
    low_m: tuple[float, float, float]
    step_m: tuple[float, float, float]
    onset_m: Array
    release_m: Array
    turn_m: float
    rest_distance_m: float
    stiffness_n_per_m: float
    volts_per_m: float
    is_force: bool


class MapState(NamedTuple):
    """Height of the base [m], share of the retract branch (0 to 1), whether the tip is attached, and the value."""

    z_m: float
    share: float
    attached: bool
    value: float


@compiled
def _weights(place: float, count: int) -> tuple[int, float, float, float, float]:
    """Return the index of the first of four grid points and their weights; a point outside has the weight 0."""
    if count == 1:
        return 0, 1.0, 0.0, 0.0, 0.0
    at = min(max(place, 0.0), count - 1.0)
    i = min(int(at), count - 2)
    t = at - i
    a = ((2.0 - t) * t - 1.0) * t * 0.5
    b = ((3.0 * t - 5.0) * t * t + 2.0) * 0.5
    c = ((4.0 - 3.0 * t) * t + 1.0) * t * 0.5
    d = (t - 1.0) * t * t * 0.5
    if count == 2:
        return 0, 1.0 - t, t, 0.0, 0.0
    # The point beyond an end continues the parabola through the three next to it.
    if i == 0:
        b, c, d, a = b + 3.0 * a, c - 3.0 * a, d + a, 0.0
    if i == count - 2:
        a, b, c, d = a + d, b - 3.0 * d, c + 3.0 * d, 0.0
    return i - 1, a, b, c, d


@compiled
def value_at(values: Array, branch: int, place: tuple[float, float, float]) -> float:
    """Return the value of a branch at a place, in grid steps from the first point.

    Raises:
        ValueError: The place is not finite; compiled code would use it as an index anywhere in memory.
    """
    if not (math.isfinite(place[0]) and math.isfinite(place[1]) and math.isfinite(place[2])):
        raise ValueError("the place on a recorded map must be finite")
    _, nx, ny, nz = values.shape
    x, y, z = _weights(place[0], nx), _weights(place[1], ny), _weights(place[2], nz)
    total = 0.0
    for p in range(4):
        u = _nth(x, p)
        if u == 0.0:
            continue
        i, plane = x[0] + p, 0.0
        for q in range(4):
            v = _nth(y, q)
            if v == 0.0:
                continue
            j, line = y[0] + q, 0.0
            for r in range(4):
                w = _nth(z, r)
                if w != 0.0:
                    line += w * float(values[branch, i, j, z[0] + r])
            plane += v * line
        total += u * plane
    return total


@compiled
def _nth(weights: tuple[int, float, float, float, float], p: int) -> float:
    """Return the weight p: compiled code can index a tuple of mixed types by constants only."""
    if p == 0:
        return weights[1]
    if p == 1:
        return weights[2]
    return weights[3] if p == 2 else weights[4]


@compiled
def _nearest(place: float, count: int) -> int:
    return int(min(max(place + 0.5, 0.0), count - 1.0))


@compiled
def _branch(params: MapParams, state: MapState, z_m: float, onset_m: float, release_m: float) -> tuple[float, bool]:
    """Return the share of the retract branch at a height, and whether the tip is attached."""
    if params.values.shape[0] == 1:
        return 0.0, z_m <= onset_m
    share, attached, moved = state.share, state.attached, (z_m - state.z_m) / params.turn_m
    if z_m <= onset_m:
        return min(max(share + moved, 0.0), 1.0), True
    if z_m >= release_m or not attached:
        return 0.0, False
    return min(share + max(moved, 0.0), 1.0), True


@compiled
def step(params: MapParams, state: MapState, inputs: PlantInputs, dt: float) -> tuple[MapState, AfmSample]:
    """Move the base over the map and return the new state and the reading."""
    z_m = params.rest_distance_m - inputs.base_m - inputs.height_m
    low, size = params.low_m, params.step_m
    place = ((inputs.x_m - low[0]) / size[0], (inputs.y_m - low[1]) / size[1], (z_m - low[2]) / size[2])
    first = value_at(params.values, 0, place)
    i, j = _nearest(place[0], params.onset_m.shape[0]), _nearest(place[1], params.onset_m.shape[1])
    share, attached = _branch(params, state, z_m, float(params.onset_m[i, j]), float(params.release_m[i, j]))
    value = first
    if share > 0.0:
        value = first + share * (value_at(params.values, 1, place) - first)
    force = value if params.is_force else 0.0
    deflection = force / params.stiffness_n_per_m
    return MapState(z_m, share, attached, value), AfmSample(
        base_m=inputs.base_m,
        deflection_m=deflection,
        force_n=force,
        bridge_voltage_v=params.volts_per_m * deflection,
        distance_m=0.0,
        distance_valid=False,
        in_contact=attached,
        meniscus=False,
        lateral_x_n=0.0,
        lateral_y_n=0.0,
    )


def start(params: MapParams, inputs: PlantInputs) -> MapState:
    """Return the state of a tip that came from above the map."""
    above = MapState(math.inf, 0.0, False, 0.0)
    return step(params, above._replace(z_m=params.rest_distance_m - inputs.base_m), inputs, 0.0)[0]

"""Feeling a measured channel: a table turns a frequency shift, a current or an amplitude into the force of the hand.

The operator then feels no force on the tip, and the rig says so wherever it shows that force. The rows of a table go
from far to near. Value and force must be monotone, because a reversed slope would drive the hand instead of holding it
back. A frequency shift is not monotone over the height: it has a minimum. So a table is valid on one branch, from its
first row to its last, and the tip is retracted when it leaves the branch: on a value beyond the last row, on one that
is no finite number, or on one that goes back by more than `tolerance` while the base continues. A change in x or y
restarts that comparison, because the value changes with the place.
"""

import math
from bisect import bisect_right
from typing import Literal, NamedTuple

from telenano.extend.stage import Place

ChannelName = Literal["frequency_shift", "current", "amplitude", "phase"]
# Causes that changed or ended the force of the table, as `LimitedForce.clamp` names them.
SATURATED = "saturated"
BOUNDS = "bounds"
RATE = "rate"
LEFT = "left"


class FeltParams(NamedTuple):
    """Sign of the change of the value towards the sample, 1 or -1; sign times value, rising, and force of each row.

    Then the tolerance of the value, the limit of the rate [N/s] and the bounds [N] of the force; values are in the SI
    unit of the channel, forces in N.
    """

    sense: float
    nearness: tuple[float, ...]
    force_n: tuple[float, ...]
    tolerance: float
    rate_n_per_s: float
    least_n: float
    most_n: float


class FeltState(NamedTuple):
    """Last force felt [N]; whether the branch was left; base [m] and value to compare with, infinite before the first.

    place: place of the tip at that value.
    """

    force_n: float = 0.0
    left: bool = False
    base_m: float = math.inf
    nearness: float = math.inf
    place: Place = Place(0.0, 0.0)


class FeltInputs(NamedTuple):
    """Value of the channel [SI unit], base [m], place of the tip, and whether it is retracted, which restarts all."""

    value: float
    base_m: float
    place: Place
    is_retracted: bool


class LimitedForce(NamedTuple):
    """Force [N], and the cause that changed or ended it: `saturated`, `bounds`, `rate`, `left`; empty for none."""

    force_n: float
    clamp: str


def felt_step(params: FeltParams, state: FeltState, inputs: FeltInputs, dt: float) -> tuple[FeltState, LimitedForce]:
    """Return the force felt for a value, dt [s] after the last one; once the branch is left it goes to 0 N.

    A branch that was left stays left until the tip is retracted.
    """
    near = params.sense * inputs.value
    anchor, back = _compared(state, inputs, near)
    is_on = math.isfinite(near) and near <= params.nearness[-1] and not back > params.tolerance
    left = not is_on or (state.left and not inputs.is_retracted)
    force, clamp = _tabulated(params, near) if not left else (0.0, LEFT)
    bounded = min(max(force, params.least_n), params.most_n)
    if bounded != force:
        clamp = BOUNDS
    reach = params.rate_n_per_s * dt
    limited = min(max(bounded, state.force_n - reach), state.force_n + reach)
    if limited != bounded and not left:
        clamp = RATE
    return FeltState(limited, left, *anchor), LimitedForce(limited, clamp)


def _compared(state: FeltState, inputs: FeltInputs, near: float) -> tuple[tuple[float, float, Place], float]:
    """Return the reference for the next value, and how far this value goes back against the motion of the base."""
    here = (inputs.base_m, near, inputs.place)
    if not math.isfinite(state.base_m) or inputs.place != state.place or inputs.is_retracted or not math.isfinite(near):
        return here, 0.0
    way, rise = inputs.base_m - state.base_m, near - state.nearness
    back = -rise if way > 0.0 else rise if way < 0.0 else 0.0
    # Only a value that goes with the base becomes the new reference: so noise cannot carry it over a turning point.
    return (here if back < 0.0 else (state.base_m, state.nearness, state.place)), back


def _tabulated(params: FeltParams, near: float) -> tuple[float, str]:
    values, forces = params.nearness, params.force_n
    if near < values[0]:
        return forces[0], SATURATED
    i = min(bisect_right(values, near) - 1, len(values) - 2)
    share = (near - values[i]) / (values[i + 1] - values[i])
    return forces[i] + share * (forces[i + 1] - forces[i]), ""

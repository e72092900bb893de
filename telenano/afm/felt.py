"""Feeling a measured channel: a table makes the force of the hand out of a frequency shift, a current, an amplitude.

What is felt then is no force on the tip, and the rig states it wherever it shows it. The rows of a table go from far to
near. Value and force are monotone in it, because a hand on a reversed slope would be driven instead of held back. A
frequency shift is not monotone over the height: it has a minimum. So a table holds on one branch, from its first row
to its last, and the tip is retracted when it leaves the branch: by a value beyond the last row, by one that is no
number, or by one that goes back by more than `tolerance` while the base continues. A change in x or y begins that
comparison again, because the value changes with the place.
"""

import math
from bisect import bisect_right
from itertools import pairwise
from typing import Literal, NamedTuple, Self

from pydantic import Field, model_validator

from telenano.extend.maps import SI_UNITS, UNITS
from telenano.extend.stage import Place
from telenano.settings.config import Settings

ChannelName = Literal["frequency_shift", "current", "amplitude", "phase"]
# These names say what has changed or ended the force of the table.
SATURATED = "saturated"
BOUNDS = "bounds"
RATE = "rate"
LEFT = "left"


class FeelConfig(Settings):
    """A measured channel that is felt in place of the force, by a table that holds on one branch of it."""

    channel: ChannelName = Field(description="What is felt: a channel that the instrument measures.")
    unit: str = Field(description="Unit of the values and of tolerance, such as Hz, pA, nm, deg.")
    table: list[list[float]] = Field(
        min_length=2,
        max_length=1000,
        description="Rows of value [unit] and force [N], from far to near; both monotone, the force of one sign.",
    )
    tolerance: float = Field(
        gt=0.0, description="How far the value may go back while the base advances [unit]: its noise, peak to peak."
    )
    slope_limit_n_per_unit: float = Field(gt=0.0, description="Steepest part that the table may have [N/unit].")
    rate_limit_n_per_s: float = Field(
        1e-6, gt=0.0, le=1.0, description="Fastest change of the force that is felt [N/s]."
    )
    least_n: float = Field(-1e-6, ge=-1e-3, le=0.0, description="Least force that is felt [N].")
    most_n: float = Field(1e-6, ge=0.0, le=1e-3, description="Greatest force that is felt [N].")

    @model_validator(mode="after")
    def _usable(self) -> Self:
        quantity = UNITS.get(self.unit, ("", 0.0))[0]
        if quantity != self.channel:
            raise ValueError(
                f"unit: {self.unit!r} is not a unit of {self.channel}, which is in {SI_UNITS[self.channel]}"
            )
        for number, row in enumerate(self.table, 1):
            if len(row) != 2:
                raise ValueError(f"table: row {number} has {len(row)} numbers; it must have a value and a force")
        ways = [(after[0] - before[0], after[1] - before[1]) for before, after in pairwise(self.table)]
        for column, name in ((0, "value"), (1, "force")):
            turn = next((i for i, way in enumerate(ways) if not way[column] * ways[0][column] > 0.0), None)
            if turn is not None:
                raise ValueError(
                    f"table: the {name} is not monotone at row {turn + 2}: a table holds on one branch, to where it"
                    " turns"
                )
        if min(row[1] for row in self.table) < 0.0 < max(row[1] for row in self.table):
            raise ValueError(
                "table: the force changes its sign; on one branch it pulls throughout, or pushes throughout"
            )
        for number, (value, force) in enumerate(ways, 1):
            slope = abs(force / value)
            if slope > self.slope_limit_n_per_unit * (1.0 + 1e-9):
                raise ValueError(
                    f"table: between rows {number} and {number + 1} its slope is {slope:.3g} N/{self.unit}, more than"
                    f" slope_limit_n_per_unit = {self.slope_limit_n_per_unit:g}"
                )
        return self

    def to_params(self) -> "FeltParams":
        scale = UNITS[self.unit][1]
        sense = 1.0 if self.table[-1][0] > self.table[0][0] else -1.0
        return FeltParams(
            sense,
            tuple(sense * scale * row[0] for row in self.table),
            tuple(row[1] for row in self.table),
            scale * self.tolerance,
            self.rate_limit_n_per_s,
            self.least_n,
            self.most_n,
        )


class FeltParams(NamedTuple):
    """Sense of the value on the way to the sample, 1 or -1; sense times value, rising, and force of each row.

    Then tolerance, rate [N/s] and bounds [N]; values in the SI unit of the channel, forces in N.
    """

    sense: float
    nearness: tuple[float, ...]
    force_n: tuple[float, ...]
    tolerance: float
    rate_n_per_s: float
    least_n: float
    most_n: float


class FeltState(NamedTuple):
    """Force felt last [N]; whether the branch was left; base [m] and value to compare with, infinite before the first.

    place: of the tip then.
    """

    force_n: float = 0.0
    left: bool = False
    base_m: float = math.inf
    nearness: float = math.inf
    place: Place = Place(0.0, 0.0)


class FeltInputs(NamedTuple):
    """Value of the channel [SI unit], base [m], place of the tip, and whether it is retracted, which begins again."""

    value: float
    base_m: float
    place: Place
    is_retracted: bool


class Felt(NamedTuple):
    """Force [N], and what changed or ended it: `saturated`, `bounds`, `rate`, `left`; empty for nothing."""

    force_n: float
    clamp: str


def felt_step(params: FeltParams, state: FeltState, inputs: FeltInputs, dt: float) -> tuple[FeltState, Felt]:
    """Return the force that a value is felt as, dt [s] after the last one; once the branch is left, none."""
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
    return FeltState(limited, left, *anchor), Felt(limited, clamp)


def _compared(state: FeltState, inputs: FeltInputs, near: float) -> tuple[tuple[float, float, Place], float]:
    """Return what the next value is compared with, and how far this one goes back against the motion of the base."""
    here = (inputs.base_m, near, inputs.place)
    if not math.isfinite(state.base_m) or inputs.place != state.place or inputs.is_retracted or not math.isfinite(near):
        return here, 0.0
    way, rise = inputs.base_m - state.base_m, near - state.nearness
    back = -rise if way > 0.0 else rise if way < 0.0 else 0.0
    # Only a value that goes with the base moves the comparison on: noise cannot carry it over a turning point.
    return (here if back < 0.0 else (state.base_m, state.nearness, state.place)), back


def _tabulated(params: FeltParams, near: float) -> tuple[float, str]:
    values, forces = params.nearness, params.force_n
    if near < values[0]:
        return forces[0], SATURATED
    i = min(bisect_right(values, near) - 1, len(values) - 2)
    share = (near - values[i]) / (values[i + 1] - values[i])
    return forces[i] + share * (forces[i + 1] - forces[i]), ""

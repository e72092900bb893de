"""An image taken by the node: a raster of the stage and the feedback that holds the force, one step a period.

The feedback is integral, on the deflection that is missing to the set-point: it moves the base by gain times that way
in a second. What the base does is the picture, height = -x_s, up to a constant. On a tip of stiffness k over a contact
of stiffness c the loop closes k + c over c times as slowly as on a rigid sample.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from services.afm_node.lateral import Place

Array = npt.NDArray[np.float64]

# phases, in order
RISE, TRAVEL, APPROACH, SETTLE, LINES, DONE = range(6)
# a step of the feedback moves the base by no more than this share of the missing deflection: beyond 2 it is unstable
_MOST_GAIN_A_STEP = 0.9


class RasterPlan(NamedTuple):
    """What is imaged and how: centre and sides [m], pixels and lines, time of a line each way [s].

    stiffness_n_per_m turns the force into a deflection; clear_m is the base above every point [m], where the tip moves
    to the first one.
    """

    centre: Place
    width_m: float
    depth_m: float
    pixels: int
    lines: int
    line_s: float
    setpoint_n: float
    gain_per_s: float
    approach_m_per_s: float
    settle_s: float
    stiffness_n_per_m: float
    clear_m: float


class RasterState(NamedTuple):
    """Phase; line and sense; time in the phase or line [s]; of its pixels sums of height [m] and force [N], counts."""

    phase: int
    line: int
    backward: bool
    elapsed_s: float
    height_sum: Array
    lateral_sum: Array
    counts: Array


class FinishedLine(NamedTuple):
    """A line: its number and sense, its ends at the middles of the outer pixels, heights [m], forces in x [N]."""

    line: int
    backward: bool
    start: Place
    end: Place
    height_m: Array
    lateral_n: Array


def begun(plan: RasterPlan) -> RasterState:
    """Return the state in which an image begins: the tip rises first."""
    return RasterState(RISE, 0, False, 0.0, *_no_samples(plan))


def raster_step(
    plan: RasterPlan,
    state: RasterState,
    base_m: float,
    place: Place,
    force_n: float,
    lateral_n: float,
    dt: float,
    *,
    paused: bool,
) -> tuple[RasterState, float, Place, FinishedLine | None]:
    """Take what was measured at the last step, and return where base [m] and stage are to go in the next dt [s].

    Parameters: base_m, place, force_n and lateral_n (along x) [N], as measured; paused, the stage stands and the force
    is held.
    Returns: state, base reference x_s [m], lateral target, and a line where one was finished.
    """
    phase, elapsed = state.phase, state.elapsed_s + dt
    first = _point(plan, 0, 0.0)
    if phase == RISE:
        return (_in(state, TRAVEL) if base_m <= plan.clear_m else state), plan.clear_m, place, None
    if phase == TRAVEL:
        return (_in(state, APPROACH) if place == first else state), plan.clear_m, first, None
    if phase == APPROACH:
        if force_n >= plan.setpoint_n:
            return _in(state, SETTLE), base_m, first, None
        return state, base_m + plan.approach_m_per_s * dt, first, None
    if phase == DONE:
        return state, base_m, place, None
    held = base_m + held_force_m(plan, force_n, dt)
    if phase == SETTLE:
        return (_in(state, LINES) if elapsed >= plan.settle_s else state._replace(elapsed_s=elapsed)), held, first, None
    if paused:
        return state, held, place, None
    state, target, finished = _advance(plan, state._replace(elapsed_s=elapsed), base_m, place, lateral_n)
    return state, held, target, finished


def held_force_m(plan: RasterPlan, force_n: float, dt: float) -> float:
    """Return how far the base is to go towards the sample in dt [s], for the force to come to its set-point."""
    missing_m = (plan.setpoint_n - force_n) / plan.stiffness_n_per_m
    return missing_m * min(plan.gain_per_s * dt, _MOST_GAIN_A_STEP)


def _in(state: RasterState, phase: int) -> RasterState:
    return state._replace(phase=phase, elapsed_s=0.0)


def _point(plan: RasterPlan, line: int, share: float) -> Place:
    """Return the place of a share of a line, from its left to its right edge."""
    x = plan.centre.x_m + (share - 0.5) * plan.width_m
    return Place(x, plan.centre.y_m + ((line + 0.5) / plan.lines - 0.5) * plan.depth_m)


def _advance(
    plan: RasterPlan, state: RasterState, base_m: float, place: Place, lateral_n: float
) -> tuple[RasterState, Place, FinishedLine | None]:
    """Count the sample where the tip is, and go on along the line; at its end turn, and after both ways to the next."""
    left = plan.centre.x_m - 0.5 * plan.width_m
    pixel = min(max(int((place.x_m - left) / plan.width_m * plan.pixels), 0), plan.pixels - 1)
    state.height_sum[pixel] -= base_m
    state.lateral_sum[pixel] += lateral_n
    state.counts[pixel] += 1.0
    share = min(state.elapsed_s / plan.line_s, 1.0)
    end = _point(plan, state.line, 0.0 if state.backward else 1.0)
    if share < 1.0 or place != end:
        return state, _point(plan, state.line, 1.0 - share if state.backward else share), None
    finished = FinishedLine(
        state.line,
        state.backward,
        _point(plan, state.line, 0.5 / plan.pixels),
        _point(plan, state.line, 1.0 - 0.5 / plan.pixels),
        _filled(state.height_sum, state.counts),
        _filled(state.lateral_sum, state.counts),
    )
    line = state.line + int(state.backward)
    phase = DONE if line == plan.lines else LINES
    after = RasterState(phase, line, not state.backward, 0.0, *_no_samples(plan))
    target = place if phase == DONE else _point(plan, line, 0.0 if state.backward else 1.0)
    return after, target, finished


def _no_samples(plan: RasterPlan) -> tuple[Array, Array, Array]:
    return np.zeros(plan.pixels), np.zeros(plan.pixels), np.zeros(plan.pixels)


def _filled(total: Array, counts: Array) -> Array:
    """Return the means; a pixel that the tip crossed between two steps lies between its neighbours."""
    known = np.flatnonzero(counts)
    return np.asarray(np.interp(np.arange(len(counts)), known, total[known] / counts[known]))


def line_fault(plan: RasterPlan, reach_m: float, speed_m_per_s: float, force_limit_n: float, period_s: float) -> str:
    """Return what of a plan cannot be done with a stage and a guard, and what would be right; empty for none."""
    furthest = max(
        abs(plan.centre.x_m) + 0.5 * plan.width_m,
        abs(plan.centre.y_m) + 0.5 * plan.depth_m,
    )
    if furthest > reach_m:
        return f"the image reaches {furthest:.3g} m from the centre, and lateral.reach_m is {reach_m:g} m"
    speed = plan.width_m / plan.line_s
    if speed > speed_m_per_s:
        needed_s = plan.width_m / speed_m_per_s / plan.pixels
        return (
            f"a line would need {speed:.3g} m/s, above lateral.speed_m_per_s = {speed_m_per_s:g} m/s: a dwell of"
            f" {needed_s:.3g} s or more on each pixel is within it"
        )
    if plan.line_s < 2.0 * period_s * plan.pixels:
        return f"a pixel needs at least two steps of the instrument: a dwell of {2.0 * period_s:g} s or more"
    if not plan.setpoint_n < force_limit_n:
        return f"the set-point {plan.setpoint_n:g} N must be below safety.force_limit_n = {force_limit_n:g} N"
    return "" if math.isfinite(plan.clear_m) else "the base has no safe position"

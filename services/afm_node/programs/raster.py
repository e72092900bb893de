"""An image taken by the node: a raster of the stage and the feedback that holds force or amplitude, one step a period.

The feedback (`feedback`) acts on the deflection that is missing to the set-point, or in tapping mode on the amplitude
above its own. What the base does is the picture, height = -x_s, up to a constant. On a tip of stiffness k over a
contact of stiffness c the loop closes k + c over c times as slowly as on a rigid sample. The amplitude follows within
Q / (pi f), 0.2 ms in Table 2, and is read before it has: at the next step.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from services.afm_node.driver import Oscillation
from services.afm_node.programs.feedback import carried_out, feedback_step, gain_fault, integral_share
from services.afm_node.programs.lateral import Place

Array = npt.NDArray[np.float64]

# phases, in order
RISE, TRAVEL, APPROACH, SETTLE, LINES, DONE = range(6)
# of the gains, for whoever gave them by `set`, in a scenario, or on the command line
_GAINS = ("scan.gain_per_s (--gain)", "scan.proportional (--proportional)")


class RasterPlan(NamedTuple):
    """What is imaged and how: centre and sides [m], pixels and lines, time of a line each way [s].

    stiffness_n_per_m turns the force into a deflection; clear_m is the base above every point [m], where the tip moves
    to the first one; amplitude_m, the set-point of the amplitude in tapping mode [m], 0 in contact mode; gain_per_s and
    proportional, Ki and Kp of the feedback; period_s, its period; lag, what is left of a change of the amplitude then;
    approach_s, the time after which an approach has found no surface [s].
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
    amplitude_m: float = 0.0
    proportional: float = 0.0
    period_s: float = 0.0
    lag: float = 0.0
    approach_s: float = math.inf

    @property
    def loop_lag(self) -> float | None:
        return self.lag if self.amplitude_m > 0.0 else None


class Measured(NamedTuple):
    """What the last step gave: base x_s [m] and place; force along z and x on the tip [N]; vibration of the tip."""

    base_m: float
    place: Place
    force_n: float
    lateral_n: float
    oscillation: Oscillation


class RasterState(NamedTuple):
    """Phase; line and sense; time in the phase or line [s]; of its pixels sums of height [m] and force [N], counts.

    Sums of the vibration's parts in phase with the drive and a quarter of a period behind it [m], and of the energy
    that the sample takes in a period [J]. Where the base was sent at the last step, and the proportional part in that.
    """

    phase: int
    line: int
    backward: bool
    elapsed_s: float
    height_sum: Array
    lateral_sum: Array
    counts: Array
    in_phase_sum: Array
    quadrature_sum: Array
    dissipated_sum: Array
    reference_m: float = 0.0
    proportional_m: float = 0.0


class FinishedLine(NamedTuple):
    """A line: its number and sense, its ends at the middles of the outer pixels, heights [m], forces in x [N].

    Amplitude [m], phase against the drive [rad] and energy that the sample takes in a period [J], None in contact mode.
    """

    line: int
    backward: bool
    start: Place
    end: Place
    height_m: Array
    lateral_n: Array
    amplitude_m: Array | None = None
    phase_rad: Array | None = None
    dissipated_j: Array | None = None


def begun(plan: RasterPlan) -> RasterState:
    """Return the state in which an image begins: the tip rises first."""
    return RasterState(RISE, 0, False, 0.0, *_no_samples(plan))


def raster_step(
    plan: RasterPlan, state: RasterState, measured: Measured, dt: float, *, paused: bool
) -> tuple[RasterState, float, Place, FinishedLine | None]:
    """Take what was measured at the last step, and return where base [m] and stage are to go in the next dt [s].

    Parameters: paused, the stage stands and the force, or the amplitude, is held.
    Returns: state, base reference x_s [m], lateral target, and a line where one was finished.
    """
    phase, elapsed, base_m, place = state.phase, state.elapsed_s + dt, measured.base_m, measured.place
    first = begin_of(plan)
    if phase == RISE:
        return (_in(state, TRAVEL) if base_m <= plan.clear_m else state), plan.clear_m, place, None
    if phase == TRAVEL:
        return (_in(state, APPROACH) if place == first else state), plan.clear_m, first, None
    if phase == APPROACH:
        if (error_m := missing_m(plan, measured)) <= 0.0:
            # the base goes on from where it is
            settling = _in(state, SETTLE)._replace(reference_m=base_m, proportional_m=plan.proportional * error_m)
            return settling, base_m, first, None
        return state._replace(elapsed_s=elapsed), base_m + plan.approach_m_per_s * dt, first, None
    if phase == DONE:
        return state, base_m, place, None
    part_m = carried_out(state.proportional_m, state.reference_m - base_m)
    share = integral_share(plan.gain_per_s, plan.proportional, plan.period_s, plan.loop_lag, dt)
    held, part_m = feedback_step(base_m, part_m, missing_m(plan, measured), share, plan.proportional)
    state = state._replace(reference_m=held, proportional_m=part_m)
    if phase == SETTLE:
        return (_in(state, LINES) if elapsed >= plan.settle_s else state._replace(elapsed_s=elapsed)), held, first, None
    if paused:
        return state, held, place, None
    state, target, finished = _advance(plan, state._replace(elapsed_s=elapsed), measured)
    return state, held, target, finished


def begin_of(plan: RasterPlan) -> Place:
    """Return the place of the first point."""
    return _point(plan, 0, 0.0)


def found_nothing(plan: RasterPlan, state: RasterState) -> bool:
    """Return whether the approach has taken longer than the whole way of the base."""
    return state.phase == APPROACH and state.elapsed_s > plan.approach_s


def missing_m(plan: RasterPlan, measured: Measured) -> float:
    """Return the error of the feedback [m], positive where the base is to go towards the sample."""
    if plan.amplitude_m > 0.0:
        return measured.oscillation.amplitude_m - plan.amplitude_m
    return (plan.setpoint_n - measured.force_n) / plan.stiffness_n_per_m


def _in(state: RasterState, phase: int) -> RasterState:
    return state._replace(phase=phase, elapsed_s=0.0)


def _point(plan: RasterPlan, line: int, share: float) -> Place:
    """Return the place of a share of a line, from its left to its right edge."""
    x = plan.centre.x_m + (share - 0.5) * plan.width_m
    return Place(x, plan.centre.y_m + ((line + 0.5) / plan.lines - 0.5) * plan.depth_m)


def _advance(
    plan: RasterPlan, state: RasterState, measured: Measured
) -> tuple[RasterState, Place, FinishedLine | None]:
    """Count the sample where the tip is, and go on along the line; at its end turn, and after both ways to the next."""
    place, left = measured.place, plan.centre.x_m - 0.5 * plan.width_m
    pixel = min(max(int((place.x_m - left) / plan.width_m * plan.pixels), 0), plan.pixels - 1)
    state.height_sum[pixel] -= measured.base_m
    state.lateral_sum[pixel] += measured.lateral_n
    if plan.amplitude_m > 0.0:
        amplitude, angle, dissipated_j = measured.oscillation
        state.in_phase_sum[pixel] += amplitude * math.cos(angle)
        state.quadrature_sum[pixel] += amplitude * math.sin(angle)
        state.dissipated_sum[pixel] += dissipated_j
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
        *((*_polar(state), _filled(state.dissipated_sum, state.counts)) if plan.amplitude_m > 0.0 else ()),
    )
    line = state.line + int(state.backward)
    phase = DONE if line == plan.lines else LINES
    feedback = state.reference_m, state.proportional_m
    after = RasterState(phase, line, not state.backward, 0.0, *_no_samples(plan), *feedback)
    target = place if phase == DONE else _point(plan, line, 0.0 if state.backward else 1.0)
    return after, target, finished


def _no_samples(plan: RasterPlan) -> tuple[Array, Array, Array, Array, Array, Array]:
    n = plan.pixels
    return np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)


def _polar(state: RasterState) -> tuple[Array, Array]:
    """Return amplitude and phase of the means; by the mathematics library, whose bits no vector unit decides."""
    parts = (_filled(part, state.counts).tolist() for part in (state.in_phase_sum, state.quadrature_sum))
    pairs = list(zip(*parts, strict=True))
    return np.array([math.hypot(x, y) for x, y in pairs]), np.array([math.atan2(y, x) for x, y in pairs])


def _filled(total: Array, counts: Array) -> Array:
    """Return the means; a pixel that the tip crossed between two steps lies between its neighbours."""
    known = np.flatnonzero(counts)
    return np.asarray(np.interp(np.arange(len(counts)), known, total[known] / counts[known]))


def line_fault(plan: RasterPlan, reach_m: float, speed_m_per_s: float, force_limit_n: float) -> str:
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
    if plan.line_s < 2.0 * plan.period_s * plan.pixels:
        return f"a pixel needs at least two steps of the instrument: a dwell of {2.0 * plan.period_s:g} s or more"
    if plan.amplitude_m == 0.0 and not plan.setpoint_n < force_limit_n:
        return f"the set-point {plan.setpoint_n:g} N must be below safety.force_limit_n = {force_limit_n:g} N"
    if not math.isfinite(plan.clear_m):
        return "the base has no safe position"
    return gain_fault(plan.gain_per_s, plan.proportional, plan.period_s, plan.loop_lag, _GAINS)

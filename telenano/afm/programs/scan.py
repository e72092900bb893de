"""An image taken by the instrument: a raster of the stage, and feedback that holds force or amplitude each period.

The feedback (`feedback`) acts on the difference of the deflection to its set-point, or in tapping mode of the
amplitude. The motion of the base is the image: height = -x_s, up to a constant. On a tip of stiffness k over a contact
of stiffness c the loop is slower than on a rigid sample by the factor (k + c) / c. The amplitude follows within
Q / (pi f), 0.2 ms in Table 2, but is read at the next step, before it has settled.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.extend.feedback import carried_out, feedback_step, gain_fault, integral_share
from telenano.extend.programs import (
    Begun,
    FinishedLine,
    Inputs,
    Instrument,
    Program,
    Progress,
    Wanted,
    Way,
)
from telenano.extend.stage import LateralParams, Place, moved
from telenano.settings.program_settings import PIXEL_STEPS, ScanSettings
from telenano.wire.errors import RefusedError

Array = npt.NDArray[np.float64]

# The phases after the approach to the surface.
SETTLE, LINES, DONE = range(Way.ARRIVED, Way.ARRIVED + 3)
# The names of the gains in `set`, in a scenario, and on the command line, for messages.
GAIN_NAMES = ("scan.gain_per_s (--gain)", "scan.proportional (--proportional)")


class ScanPlan(NamedTuple):
    """The plan of an image: its settings, its sides [m], and properties of the instrument.

    stiffness_n_per_m: turns the force into a deflection; clear_m: base [m] at which the tip is above every point, where
    it moves to the first one; period_s: period of the feedback [s]; lag: share of a change of the amplitude that is
    left after one period; approach_s: time after which an approach is taken to have found no surface [s].
    """

    settings: ScanSettings
    width_m: float
    depth_m: float
    stiffness_n_per_m: float
    clear_m: float
    period_s: float
    lag: float
    approach_s: float

    @property
    def setpoint_m(self) -> float:
        """Return the amplitude that the feedback holds in tapping mode [m]."""
        return self.settings.setpoint_share * self.settings.free_amplitude_m

    @property
    def loop_lag(self) -> float | None:
        return self.lag if self.settings.mode == "tapping" else None

    @property
    def line_s(self) -> float:
        """Return the time of a line in one direction [s]."""
        return self.settings.pixels * self.settings.pixel_s(self.period_s)


class ScanState(NamedTuple):
    """Phase; line and direction; time in the phase or line [s]; for each pixel sums of height [m], lateral force [N].

    Then for each pixel: number of samples; sums of the vibration's components in phase with the drive and a quarter of
    a period behind it [m], and of the energy that the sample takes in a period [J]. reference_m: base commanded at the
    last step [m]; proportional_m: its proportional part [m].
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


class Scan(Program[ScanSettings, ScanPlan, ScanState]):
    """The program of an image, taken line by line, there and back."""

    settings = ScanSettings
    title = "Scan"
    about = "What is imaged."
    can_pause = True
    moves_across = True

    def begin(self, settings: ScanSettings, instrument: Instrument, place: Place) -> Begun[ScanPlan, ScanState]:
        s = settings
        if instrument.lateral is None:
            raise RefusedError("program: scan needs a lateral stage, and this instrument has none")
        if s.mode == "tapping" and not instrument.can_vibrate:
            raise RefusedError("scan.mode: tapping needs a cantilever that vibrates: afm_node.model dynamic")
        width_m, depth_m = instrument.size_m
        plan = ScanPlan(
            settings=s,
            width_m=width_m if s.width_m is None else s.width_m,
            depth_m=depth_m if s.depth_m is None else s.depth_m,
            stiffness_n_per_m=instrument.stiffness_n_per_m,
            clear_m=instrument.limits.retract_position_m,
            period_s=instrument.period_s,
            lag=instrument.lag,
            approach_s=instrument.approach_limit_s(s.approach_m_per_s),
        )
        reach_m, speed = instrument.lateral
        fault = line_fault(plan, reach_m, speed, instrument.limits.force_limit_n)
        if fault := fault or _surface_fault(plan, instrument, place):
            raise RefusedError(f"scan: {fault}")
        text = (
            f"an image of {s.pixels} x {s.lines} pixels begins, {2.0 * s.lines * plan.line_s:.0f} s for its lines after"
            f" an approach of at most {plan.approach_s:.3g} s"
        )
        return Begun(plan, ScanState(Way.RISE, 0, False, 0.0, *_no_samples(plan)), text)

    def step(self, plan: ScanPlan, state: ScanState, inputs: Inputs, dt: float) -> Wanted[ScanState]:
        state, base_m, target, line = scan_step(plan, state, inputs, dt)
        return Wanted(state, base_m, target, state.phase == DONE, line, plan.settings.free_amplitude_m)

    def progress(self, plan: ScanPlan, state: ScanState) -> Progress:
        texts = (
            *Way.TEXTS,
            "the amplitude settles" if plan.settings.mode == "tapping" else "the force settles",
            "lines",
            "done",
        )
        way = min(state.elapsed_s / plan.line_s, 1.0) if state.phase == LINES else 0.0
        lines = plan.settings.lines
        done = 2.0 * state.line + float(state.backward) + way
        return Progress(texts[state.phase], min(done / (2.0 * lines), 1.0), state.line, lines)

    def searching_s(self, plan: ScanPlan, state: ScanState) -> tuple[float, float]:
        return (state.elapsed_s if state.phase == Way.APPROACH else 0.0), plan.approach_s


def scan_step(
    plan: ScanPlan, state: ScanState, inputs: Inputs, dt: float
) -> tuple[ScanState, float, Place, FinishedLine | None]:
    """Advance the image with the measurement of the last step; return base [m] and stage target for the next dt [s].

    While the scan is paused, the stage stands still and the feedback holds the force, or the amplitude.

    Returns:
        The state, the base reference x_s [m], the lateral target, and a line if one was finished.
    """
    s, phase, elapsed = plan.settings, state.phase, state.elapsed_s + dt
    base_m, place, first = inputs.base_m, inputs.place, begin_of(plan)
    if phase <= Way.APPROACH:
        error_m, step_m = missing_m(plan, inputs), s.approach_m_per_s * dt
        way = Way.to_surface(phase, state.elapsed_s, inputs, first, plan.clear_m, step_m, error_m <= 0.0, dt)
        state = state._replace(phase=way.phase, elapsed_s=way.elapsed_s)
        if way.phase == SETTLE:
            state = state._replace(reference_m=base_m, proportional_m=s.proportional * error_m)
        return state, way.base_m, way.place, None
    if phase == DONE:
        return state, base_m, place, None
    part_m = carried_out(state.proportional_m, state.reference_m - base_m)
    share = integral_share(s.gain_per_s, s.proportional, plan.period_s, plan.loop_lag, dt)
    held, part_m = feedback_step(base_m, part_m, missing_m(plan, inputs), share, s.proportional)
    state = state._replace(reference_m=held, proportional_m=part_m)
    if phase == SETTLE:
        is_settled = elapsed >= s.settle_s
        state = state._replace(phase=LINES if is_settled else SETTLE, elapsed_s=0.0 if is_settled else elapsed)
        return state, held, first, None
    if inputs.is_paused:
        return state, held, place, None
    if not state.backward and place.y_m != _point(plan, state.line, 0.0).y_m:
        return state, held, _towards(plan, state.line, place, dt), None
    state, target, finished = _advance(plan, state._replace(elapsed_s=elapsed), inputs, dt)
    return state, held, target, finished


def begin_of(plan: ScanPlan) -> Place:
    """Return the place of the first point."""
    return _point(plan, 0, 0.0)


def missing_m(plan: ScanPlan, inputs: Inputs) -> float:
    """Return the error of the feedback [m], positive if the base has to go towards the sample."""
    if plan.settings.mode == "tapping":
        return inputs.oscillation.amplitude_m - plan.setpoint_m
    return (plan.settings.setpoint_n - inputs.force_n) / plan.stiffness_n_per_m


def _point(plan: ScanPlan, line: int, share: float) -> Place:
    """Return the place on a line, with share 0 at its left edge and 1 at its right edge."""
    s = plan.settings
    x = s.x_m + (share - 0.5) * plan.width_m
    return Place(x, s.y_m + ((line + 0.5) / s.lines - 0.5) * plan.depth_m)


def _towards(plan: ScanPlan, line: int, place: Place, dt: float) -> Place:
    """Return the place of the tip after dt [s] on its way to the beginning of a line.

    The tip moves no faster than along a line, because the feedback could not follow a steeper rise: in contact the tip
    would press on an obstacle, or push a particle.
    """
    return moved(LateralParams(math.inf, plan.width_m / plan.line_s), place, _point(plan, line, 0.0), dt)[0]


def _advance(
    plan: ScanPlan, state: ScanState, inputs: Inputs, dt: float
) -> tuple[ScanState, Place, FinishedLine | None]:
    """Add the sample to the pixel under the tip and advance along the line; turn at its end, then go to the next line.

    Returns:
        The state, the lateral target, and a line if one was finished.
    """
    s = plan.settings
    place, left = inputs.place, s.x_m - 0.5 * plan.width_m
    pixel = min(max(int((place.x_m - left) / plan.width_m * s.pixels), 0), s.pixels - 1)
    state.height_sum[pixel] -= inputs.base_m
    state.lateral_sum[pixel] += inputs.lateral_n[0]
    if s.mode == "tapping":
        amplitude, angle, dissipated_j = inputs.oscillation
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
        _point(plan, state.line, 0.5 / s.pixels),
        _point(plan, state.line, 1.0 - 0.5 / s.pixels),
        _filled(state.height_sum, state.counts),
        _filled(state.lateral_sum, state.counts),
        *((*_polar(state), _filled(state.dissipated_sum, state.counts)) if s.mode == "tapping" else ()),
    )
    line = state.line + int(state.backward)
    phase = DONE if line == s.lines else LINES
    feedback = state.reference_m, state.proportional_m
    after = ScanState(phase, line, not state.backward, 0.0, *_no_samples(plan), *feedback)
    return after, place if phase == DONE or not state.backward else _towards(plan, line, place, dt), finished


def _no_samples(plan: ScanPlan) -> tuple[Array, Array, Array, Array, Array, Array]:
    n = plan.settings.pixels
    return np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)


def _polar(state: ScanState) -> tuple[Array, Array]:
    """Return amplitude [m] and phase [rad] of the mean components; `math` gives the same bits on every processor."""
    parts = (_filled(part, state.counts).tolist() for part in (state.in_phase_sum, state.quadrature_sum))
    pairs = list(zip(*parts, strict=True))
    return np.array([math.hypot(x, y) for x, y in pairs]), np.array([math.atan2(y, x) for x, y in pairs])


def _filled(total: Array, counts: Array) -> Array:
    """Return the mean of each pixel; pixels without a sample are interpolated between their neighbours."""
    measured = np.flatnonzero(counts)
    return np.asarray(np.interp(np.arange(len(counts)), measured, total[measured] / counts[measured]))


def line_fault(plan: ScanPlan, reach_m: float, speed_m_per_s: float, force_limit_n: float) -> str:
    """Return the reason why stage or guard cannot carry out a plan, with a remedy; empty if they can."""
    s = plan.settings
    furthest = max(abs(s.x_m) + 0.5 * plan.width_m, abs(s.y_m) + 0.5 * plan.depth_m)
    if furthest > reach_m:
        return f"the image reaches {furthest:.3g} m from the centre, and lateral.reach_m is {reach_m:g} m"
    speed = plan.width_m / plan.line_s
    if speed > speed_m_per_s:
        needed_s = plan.width_m / speed_m_per_s / s.pixels
        return (
            f"a line would need {speed:.3g} m/s, above lateral.speed_m_per_s = {speed_m_per_s:g} m/s: a dwell of"
            f" {needed_s:.3g} s or more on each pixel is within it"
        )
    if plan.line_s < PIXEL_STEPS * plan.period_s * s.pixels:
        least_s = PIXEL_STEPS * plan.period_s
        return f"a pixel needs at least {PIXEL_STEPS} steps of the instrument: a dwell of {least_s:g} s or more"
    if s.mode == "contact" and not s.setpoint_n < force_limit_n:
        return f"the set-point {s.setpoint_n:g} N must be below safety.force_limit_n = {force_limit_n:g} N"
    if not math.isfinite(plan.clear_m):
        return "the base has no safe position"
    return gain_fault(s.gain_per_s, s.proportional, plan.period_s, plan.loop_lag, GAIN_NAMES)


def _surface_fault(plan: ScanPlan, instrument: Instrument, place: Place) -> str:
    """Return why the base cannot follow the surface of an image, or the tip cannot get there; empty if both can."""
    s, reach = plan.settings, instrument.reach
    if reach is None:
        return ""
    image = reach.within(Place(s.x_m, s.y_m), plan.width_m, plan.depth_m)
    # In tapping mode the mean of the tip stays an amplitude above the sample; in contact the tip bends towards it.
    press_m = -plan.setpoint_m if s.mode == "tapping" else s.setpoint_n / plan.stiffness_n_per_m
    way = reach.along(place, begin_of(plan))
    clear = reach.retracted_fault(image, s.free_amplitude_m) or reach.retracted_fault(way, s.free_amplitude_m)
    return reach.depth_fault(image, press_m) or clear

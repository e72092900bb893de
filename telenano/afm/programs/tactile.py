"""A path that the operator feels (Fig. 9-10): the tip touches the sample and follows a line, or a pointer.

The haptic device follows up to its bandwidth f_m, so features of the length dL can be felt only at speeds

    v <= dL f_m                                                                                              (Eq. 14)

and the stage goes no faster. The base stands still, so that the deflection is the height (Fig. 9), or holds the force.
"""

import math
from typing import NamedTuple

from telenano.extend.feedback import gain_fault, integral_share
from telenano.extend.programs import (
    Begun,
    Inputs,
    Instrument,
    Program,
    Progress,
    Wanted,
    Way,
)
from telenano.extend.stage import LateralParams, Place, moved
from telenano.settings.program_settings import TactileSettings
from telenano.wire.errors import RefusedError

# The phases after the approach to the surface.
FEEL = Way.ARRIVED
DONE = Way.ARRIVED + 1
# The names of the gains in the settings, for messages.
_GAINS = ("tactile.gain_per_s", "")


class TactilePlan(NamedTuple):
    """The plan of a path: its settings, its ends, the speed limited by Eq. 14 [m/s], and properties of the instrument.

    clear_m: base [m] at which the tip is above every point; period_s: period of the feedback [s]; approach_s: time
    after which an approach is taken to have found no surface [s].
    """

    settings: TactileSettings
    start: Place
    end: Place
    speed_m_per_s: float
    stiffness_n_per_m: float
    clear_m: float
    period_s: float
    approach_s: float

    @property
    def by_pointer(self) -> bool:
        return self.settings.drive == "pointer"


class TactileState(NamedTuple):
    """Phase; whether the pointer was ahead of the speed limit at the last step; time of the approach so far [s]."""

    phase: int
    is_limited: bool
    approached_s: float = 0.0


class Tactile(Program[TactileSettings, TactilePlan, TactileState]):
    """The program of a path along which the tip touches the sample."""

    settings = TactileSettings
    title = "Tactile"
    about = "The path that a hand feels."
    moves_across = True
    label = "tactile path"

    def begin(
        self, settings: TactileSettings, instrument: Instrument, place: Place
    ) -> Begun[TactilePlan, TactileState]:
        if instrument.lateral is None:
            raise RefusedError("program: tactile needs a lateral stage, and this instrument has none")
        s, limits = settings, instrument.limits
        start = Place(s.x0_m, s.y0_m)
        end_x = s.x0_m + 0.5 * instrument.size_m[0] if s.x1_m is None else s.x1_m
        end = Place(end_x, s.y0_m if s.y1_m is None else s.y1_m)
        reach_m, fastest = instrument.lateral
        furthest = max(abs(value) for value in (*start, *end))
        if furthest > reach_m:
            raise RefusedError(f"tactile: the line reaches {furthest:.3g} m, and lateral.reach_m is {reach_m:g} m")
        if not s.setpoint_n < limits.force_limit_n:
            raise RefusedError(f"tactile.setpoint_n must be below safety.force_limit_n = {limits.force_limit_n:g} N")
        plan = TactilePlan(
            settings=s,
            start=start,
            end=end,
            speed_m_per_s=min(s.speed_m_per_s, s.felt_speed_m_per_s, fastest),
            stiffness_n_per_m=instrument.stiffness_n_per_m,
            clear_m=limits.retract_position_m,
            period_s=instrument.period_s,
            approach_s=instrument.approach_limit_s(s.approach_m_per_s),
        )
        if fault := plan_fault(plan) or _surface_fault(plan, instrument, place):
            raise RefusedError(f"tactile: {fault}")
        limited = ""
        if (speed := plan.speed_m_per_s) < s.speed_m_per_s:
            limited = f"its speed is limited from {s.speed_m_per_s:g} to {speed:g} m/s"
            if speed == s.felt_speed_m_per_s:
                limited += f": features of {s.feature_m:g} m at {s.bandwidth_hz:g} Hz (Eq. 14)"
        text = f"the tip touches the sample and goes along {'a pointer' if plan.by_pointer else 'a line'}"
        return Begun(plan, TactileState(Way.RISE, False), "; ".join(filter(None, (text, limited))), limited)

    def step(self, plan: TactilePlan, state: TactileState, inputs: Inputs, dt: float) -> Wanted[TactileState]:
        was_limited = state.is_limited
        state, base_m, target = tactile_step(plan, state, inputs, dt)
        notice = ""
        if state.is_limited and not was_limited:
            speed = plan.speed_m_per_s
            notice = f"the pointer is ahead of the tip, which goes at {speed:g} m/s: no faster motion is felt (Eq. 14)"
        return Wanted(state, base_m, target, state.phase == DONE, notice=notice)

    def progress(self, plan: TactilePlan, state: TactileState) -> Progress:
        texts = (*Way.TEXTS, "the surface is felt", "done")
        return Progress(texts[state.phase], state.phase / DONE)

    def searching_s(self, plan: TactilePlan, state: TactileState) -> tuple[float, float]:
        return (state.approached_s if state.phase == Way.APPROACH else 0.0), plan.approach_s


def tactile_step(
    plan: TactilePlan, state: TactileState, inputs: Inputs, dt: float
) -> tuple[TactileState, float, Place]:
    """Return the new state, and base [m] and stage target for the next dt [s], from the last measurement."""
    s, base_m, place = plan.settings, inputs.base_m, inputs.place
    if state.phase <= Way.APPROACH:
        touches, step_m = inputs.force_n >= s.setpoint_n, s.approach_m_per_s * dt
        way = Way.to_surface(state.phase, state.approached_s, inputs, plan.start, plan.clear_m, step_m, touches, dt)
        return TactileState(way.phase, False, way.elapsed_s), way.base_m, way.place
    if state.phase == DONE:
        return state, base_m, place
    goal = inputs.pointer if plan.by_pointer else plan.end
    if not plan.by_pointer and place == goal:
        return TactileState(DONE, False), base_m, place
    target, limited = moved(LateralParams(math.inf, plan.speed_m_per_s), place, goal, dt)
    if s.hold == "force":
        share = integral_share(s.gain_per_s, 0.0, plan.period_s, None, dt)
        base_m += (s.setpoint_n - inputs.force_n) / plan.stiffness_n_per_m * share
    return TactileState(FEEL, plan.by_pointer and limited != 0), base_m, target


def plan_fault(plan: TactilePlan) -> str:
    """Return why the feedback of a path that holds the force would be unstable; empty if nothing is wrong."""
    if plan.settings.hold != "force":
        return ""
    return gain_fault(plan.settings.gain_per_s, 0.0, plan.period_s, None, _GAINS)


def _surface_fault(plan: TactilePlan, instrument: Instrument, place: Place) -> str:
    """Return why the base cannot bring the tip to a path, or hold the force along it; empty if it can."""
    s, reach = plan.settings, instrument.reach
    if reach is None:
        return ""
    path = reach.along(plan.start, plan.start if plan.by_pointer else plan.end)
    held = path if s.hold == "force" else reach.along(plan.start, plan.start)
    fault = reach.depth_fault(held, s.setpoint_n / plan.stiffness_n_per_m)
    way = reach.along(place, plan.start)
    return fault or reach.retracted_fault(path) or reach.retracted_fault(way)

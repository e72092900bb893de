"""The program that takes a force curve: the base goes down to a load, and back up, at one speed."""

from typing import NamedTuple

from telenano.extend.programs import Begun, Inputs, Instrument, Program, Progress, Wanted
from telenano.extend.stage import Place
from telenano.settings.program_settings import CurveSettings
from telenano.wire.errors import RefusedError

# The phases, in order.
RISE, DOWN, UP, DONE = range(4)


class CurvePlan(NamedTuple):
    """Settings of the curve, and the deepest base [m], where the curve turns at any force."""

    settings: CurveSettings
    deepest_m: float


class CurveState(NamedTuple):
    """Phase, the base at which the curve turned [m], and whether the load was reached there."""

    phase: int
    turned_m: float
    loaded: bool = True


class Curve(Program[CurveSettings, CurvePlan, CurveState]):
    """A force curve: the base goes down until the load is reached, and back up."""

    settings = CurveSettings
    title = "Force curve"
    about = "The force curve."

    def begin(self, settings: CurveSettings, instrument: Instrument, place: Place) -> Begun[CurvePlan, CurveState]:
        limits, s = instrument.limits, settings
        if not -s.start_m >= limits.base_min_m:
            raise RefusedError(f"curve.start_m = {s.start_m:g} m is beyond safety.base_min_m = {limits.base_min_m:g} m")
        if not s.load_n < limits.force_limit_n:
            raise RefusedError(f"curve.load_n must be below safety.force_limit_n = {limits.force_limit_n:g} N")
        if s.speed_m_per_s > limits.base_speed_m_per_s:
            raise RefusedError(
                f"curve.speed_m_per_s is above safety.base_speed_m_per_s = {limits.base_speed_m_per_s:g}"
            )
        if (reach := instrument.reach) is not None:
            here = reach.along(place, place)
            begin = "The curve must begin with the base at {base:g} m or less (curve.start_m counts the other way)"
            if fault := reach.depth_fault(here) or reach.clearance_fault(here, -s.start_m, begin):
                raise RefusedError(f"curve: {fault}")
        text = f"a force curve to {s.load_n:g} N begins"
        return Begun(CurvePlan(s, limits.base_max_m), CurveState(RISE, 0.0), text)

    def step(self, plan: CurvePlan, state: CurveState, inputs: Inputs, dt: float) -> Wanted[CurveState]:
        was_loaded = state.loaded
        state, base_m = curve_step(plan, state, inputs.base_m, inputs.force_n, dt)
        notice = ""
        if was_loaded and not state.loaded:
            notice = (
                f"the curve turned at {state.turned_m:.3g} m, the furthest base (safety.base_max_m), where the force"
                f" was {inputs.force_n:.3g} N: its load of {plan.settings.load_n:g} N was not reached"
            )
        return Wanted(state, base_m, inputs.place, state.phase == DONE, notice=notice)

    def progress(self, plan: CurvePlan, state: CurveState) -> Progress:
        texts = ("the tip rises", "approach", "retraction", "the curve is complete")
        return Progress(texts[state.phase], state.phase / DONE)

    def shortfall(self, plan: CurvePlan, state: CurveState) -> str:
        return "" if state.loaded else " without reaching its load"


def curve_step(
    plan: CurvePlan, state: CurveState, base_m: float, force_n: float, dt: float
) -> tuple[CurveState, float]:
    """Return the new state and the base [m] to go to in the next dt [s], from the measured base [m] and force [N].

    The curve also turns at the deepest base, at any force; `loaded` is then false.
    """
    start_m, speed, load_n = -plan.settings.start_m, plan.settings.speed_m_per_s, plan.settings.load_n
    if state.phase == RISE:
        return (CurveState(DOWN, 0.0) if base_m <= start_m else state), start_m
    if state.phase == DOWN:
        if force_n >= load_n or base_m >= plan.deepest_m:
            return CurveState(UP, base_m, force_n >= load_n), base_m
        return state, min(base_m + speed * dt, plan.deepest_m)
    if state.phase == UP:
        if base_m <= start_m:
            return state._replace(phase=DONE), base_m
        return state, max(base_m - speed * dt, start_m)
    return state, base_m

"""A path that a hand feels (Fig. 9-10): the tip touches the sample and goes along a line, or where a pointer leads it.

The device behind the hand follows up to its bandwidth f_m, so features of the length dL are felt only at speeds

    v <= dL f_m                                                                                              (Eq. 14)

and the stage goes no faster. The base stands, so that the deflection is the height (Fig. 9), or holds the force.
"""

import math
from typing import NamedTuple

from services.afm_node.programs.feedback import gain_fault, integral_share
from services.afm_node.programs.lateral import LateralParams, Place, moved

# phases, in order
RISE, TRAVEL, APPROACH, FEEL, DONE = range(5)
# of the gains, for whoever gave them
_GAINS = ("tactile.gain_per_s", "")


class TactilePlan(NamedTuple):
    """The line, or only its start where a pointer leads; how the tip is brought there, and what the base does.

    speed_m_per_s: after Eq. 14; holds_force: a feedback (`feedback`) of gain_per_s with the period period_s moves the
    base; clear_m: base above every point [m]; approach_s: the time after which an approach has found no surface [s].
    """

    start: Place
    end: Place
    by_pointer: bool
    speed_m_per_s: float
    setpoint_n: float
    holds_force: bool
    gain_per_s: float
    approach_m_per_s: float
    stiffness_n_per_m: float
    clear_m: float
    period_s: float
    approach_s: float = math.inf


class TactileState(NamedTuple):
    """Phase; whether the pointer was ahead of the speed limit at the last step; time of the approach so far [s]."""

    phase: int
    is_limited: bool
    approached_s: float = 0.0


def tactile_step(
    plan: TactilePlan, state: TactileState, base_m: float, place: Place, force_n: float, pointer: Place, dt: float
) -> tuple[TactileState, float, Place]:
    """Take what was measured and return the state, and where base [m] and stage are to go in the next dt [s]."""
    if state.phase == RISE:
        return (TactileState(TRAVEL, False) if base_m <= plan.clear_m else state), plan.clear_m, place
    if state.phase == TRAVEL:
        return (TactileState(APPROACH, False) if place == plan.start else state), plan.clear_m, plan.start
    if state.phase == APPROACH:
        if force_n >= plan.setpoint_n:
            return TactileState(FEEL, False), base_m, plan.start
        approaching = state._replace(approached_s=state.approached_s + dt)
        return approaching, base_m + plan.approach_m_per_s * dt, plan.start
    if state.phase == DONE:
        return state, base_m, place
    goal = pointer if plan.by_pointer else plan.end
    if not plan.by_pointer and place == goal:
        return TactileState(DONE, False), base_m, place
    target, limited = moved(LateralParams(math.inf, plan.speed_m_per_s), place, goal, dt)
    if plan.holds_force:
        share = integral_share(plan.gain_per_s, 0.0, plan.period_s, None, dt)
        base_m += (plan.setpoint_n - force_n) / plan.stiffness_n_per_m * share
    return TactileState(FEEL, plan.by_pointer and limited != 0), base_m, target


def found_nothing(plan: TactilePlan, state: TactileState) -> bool:
    """Return whether the approach has taken longer than the whole way of the base."""
    return state.phase == APPROACH and state.approached_s > plan.approach_s


def plan_fault(plan: TactilePlan) -> str:
    """Return why a path cannot be felt as it is planned; empty for nothing."""
    if not plan.holds_force:
        return ""
    return gain_fault(plan.gain_per_s, 0.0, plan.period_s, None, _GAINS)

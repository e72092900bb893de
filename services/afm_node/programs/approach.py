"""A force curve taken by the node: down to a load, and back up, at one speed."""

from typing import NamedTuple

# phases, in order
RISE, DOWN, UP, DONE = range(4)


class CurvePlan(NamedTuple):
    """Base where both ways end [m], towards the sample; load where it turns [N]; speed [m/s]; deepest base [m]."""

    start_m: float
    load_n: float
    speed_m_per_s: float
    deepest_m: float


class CurveState(NamedTuple):
    """Phase, the base at which it turned [m], and whether the load was reached there."""

    phase: int
    turned_m: float
    loaded: bool = True


def curve_step(
    plan: CurvePlan, state: CurveState, base_m: float, force_n: float, dt: float
) -> tuple[CurveState, float]:
    """Take base [m] and force [N] as measured and return the state and where the base is to go in the next dt [s].

    It also turns at the deepest base, whatever the force: `loaded` tells.
    """
    if state.phase == RISE:
        return (CurveState(DOWN, 0.0) if base_m <= plan.start_m else state), plan.start_m
    if state.phase == DOWN:
        if force_n >= plan.load_n or base_m >= plan.deepest_m:
            return CurveState(UP, base_m, force_n >= plan.load_n), base_m
        return state, min(base_m + plan.speed_m_per_s * dt, plan.deepest_m)
    if state.phase == UP:
        if base_m <= plan.start_m:
            return state._replace(phase=DONE), base_m
        return state, max(base_m - plan.speed_m_per_s * dt, plan.start_m)
    return state, base_m

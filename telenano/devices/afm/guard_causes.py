"""The value that caused an act of the guard, in words and for the data of its event."""

import math
from typing import Any

from telenano.afm import safety
from telenano.extend.instruments import SafetyParams

Cause = tuple[str, dict[str, Any]]


def cause_of(reason: int, asked: safety.SafetyInputs, limits: SafetyParams) -> Cause:
    """Return the value behind a reason (REASON_*) and its limit, as a clause and as facts; both empty without one.

    Args:
        reason: The reason of the newest transition.
        asked: The inputs of the step in which the guard acted.
        limits: The limits of the guard.
    """
    if reason == safety.REASON_FORCE_LIMIT:
        return _force("the force on the tip", "tip_force_n", asked.force_n, limits.force_limit_n)
    if reason == safety.REASON_LATERAL_LIMIT:
        return _force("the force across the tip", "lateral_force_n", asked.lateral_n, limits.lateral_limit_n)
    if reason in (safety.REASON_COMMAND_DEADLINE, safety.REASON_HOLD_EXPIRED):
        held = limits.hold_time_s if reason == safety.REASON_HOLD_EXPIRED else 0.0
        return _age(asked.command_age_s, limits.command_deadline_s + held)
    return "", {}


def _force(what: str, key: str, value_n: float, limit_n: float) -> Cause:
    if not math.isfinite(value_n):
        # A withdrawal keeps its reason until it ends, and by then the force may be beyond the range of the input.
        return f"{what} is not measured, and its limit is {1e9 * limit_n:.3g} nN", {"limit_n": limit_n}
    text = f"{what} was {1e9 * value_n:.3g} nN, and its limit is {1e9 * limit_n:.3g} nN"
    return text, {key: value_n, "limit_n": limit_n}


def _age(age_s: float, limit_s: float) -> Cause:
    if not math.isfinite(age_s):
        return "there was no command of an armed hand", {"limit_s": limit_s}
    text = f"the newest command of an armed hand was {1e3 * age_s:.0f} ms old, and its limit is {1e3 * limit_s:.0f} ms"
    return text, {"command_age_s": age_s, "limit_s": limit_s}

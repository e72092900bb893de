"""How many cycles of the hand a session has: what a law loses a little of in each shows in many of them only."""

import numpy as np
import numpy.typing as npt

# part of the greatest force, and the force [N], by which a press has to rise and to fall: less is a tremor or noise
_LEAST_SHARE, _LEAST_N = 0.1, 0.1


def cycles_of(force_n: npt.NDArray[np.float64]) -> int:
    """Return how often a force [N], of shape (n,), rose and then fell again, by a tenth of its greatest."""
    least_n = max(_LEAST_N, _LEAST_SHARE * float(np.abs(force_n).max(initial=0.0)))
    cycles, rises, turn_n = 0, False, float(force_n[0]) if force_n.size else 0.0
    for now_n in force_n.tolist():
        turn_n = max(turn_n, now_n) if rises else min(turn_n, now_n)
        if abs(now_n - turn_n) > least_n:
            cycles += rises
            rises, turn_n = not rises, now_n
    return cycles

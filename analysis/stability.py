"""Whether a recorded session was stable: judged by what the tip's force does while the hand's force stands still."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

# shorter holds end before a slow oscillation of the loop (about 5 Hz) has shown what becomes of it
SHORTEST_HOLD_S = 0.5
# the first part of a hold shows the answer to the step before it
SETTLING_SHARE = 0.2
SMALLEST_SHARE_OF_FORCE = 0.05
LEAST_DECAY = 0.9
_HAND_STEADY_SHARE = 0.01


class Hold(NamedTuple):
    """A stretch of constant hand force, and the peak-to-peak of alpha_f F_s [N] in the last two quarters of it."""

    start_s: float
    end_s: float
    hand_force_n: float
    earlier_n: float
    later_n: float
    stable: bool


def constant_stretches(time_s: Series, force_n: Series, tolerance_n: float) -> list[tuple[float, float]]:
    """Give the stretches [s] of at least SHORTEST_HOLD_S over which a force stays within a tolerance of its start."""
    stretches: list[tuple[float, float]] = []
    first = 0
    for index in range(1, len(time_s) + 1):
        if index < len(time_s) and abs(force_n[index] - force_n[first]) <= tolerance_n:
            continue
        if time_s[index - 1] - time_s[first] >= SHORTEST_HOLD_S:
            stretches.append((float(time_s[first]), float(time_s[index - 1])))
        first = index
    return stretches


def judge_holds(hand_time_s: Series, hand_force_n: Series, tip_time_s: Series, scaled_force_n: Series) -> list[Hold]:
    """Judge every hold of a session.

    In each stretch of constant F_m, its first fifth left out, the rest is cut into quarters. The hold is unstable when
    the peak-to-peak of alpha_f F_s in the last quarter is above 5 % of the greatest hand force of the session and has
    not fallen below 90 % of that in the quarter before: an oscillation that neither is small nor dies out.

    Parameters: times [s], F_m [N] at the hand's times, alpha_f F_s [N] at the tip's times; one dimension each.
    """
    greatest = float(np.abs(hand_force_n).max(initial=0.0))
    threshold = SMALLEST_SHARE_OF_FORCE * greatest
    holds = []
    for start, end in constant_stretches(hand_time_s, hand_force_n, _HAND_STEADY_SHARE * greatest):
        edges = np.linspace(start + SETTLING_SHARE * (end - start), end, 5)
        quarters = [scaled_force_n[(tip_time_s >= a) & (tip_time_s < b)] for a, b in pairwise(edges)]
        if any(quarter.size == 0 for quarter in quarters):
            continue
        earlier, later = float(np.ptp(quarters[2])), float(np.ptp(quarters[3]))
        stable = later <= threshold or later < LEAST_DECAY * earlier
        force = float(np.interp(0.5 * (start + end), hand_time_s, hand_force_n))
        holds.append(Hold(start, end, force, earlier, later, stable))
    return holds

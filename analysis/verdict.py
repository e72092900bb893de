"""Stable, limit cycle or diverged: judged by what the tip's force does while the hand's force stands still.

A hold is cut into windows of equal length. The peak-to-peak of alpha_f F_s in each of them is the size of the motion,
and the slope of its logarithm over time is the growth rate: the real part of the loop's slowest mode while the loop is
linear, near zero for an oscillation that feeds itself.

- diverged: a guard ended the hold, or the motion still grows at the end of it;
- limit cycle: it neither grows nor dies out, and is larger than a twentieth of the hand's force;
- stable: all else.

Over a link with jitter or loss, a motion that the link itself keeps up by its randomness is neither growing nor dying
out, and counts as a limit cycle too; a trend has to be stronger there, because it may be chance.
"""

from itertools import combinations, pairwise
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]
Kind = Literal["stable", "limit_cycle", "diverged"]
KINDS: tuple[Kind, ...] = ("stable", "limit_cycle", "diverged")

WINDOWS = 8
# the windows that the growth rate is taken from: the first show the answer to the step before them
_LATE_WINDOWS = 6
# of the hand's force
SMALL_SHARE = 0.05
# below this share of the hand's force nothing is left to fit a slope to
_FLOOR_SHARE = 1e-7
# a motion that changes by less than a tenth over the fitted windows neither grows nor dies out; where chance has a hand
# in it, by less than a factor of two
_SUSTAINED_CHANGE, _NOISY_CHANGE = 0.1, 0.7
# 14 of the 15 pairs of six windows in the same order: by chance that happens once in 60 times, either way
_CLEAR_TREND = 0.85


class Verdict(NamedTuple):
    """What became of a hold: growth_per_s of the motion [1/s], None where nothing moves; its last peak-to-peak [N]."""

    kind: Kind
    growth_per_s: float | None
    peak_to_peak_n: float


def judge(
    time_s: Series, force_n: Series, hand_force_n: float, *, ended_early: bool = False, noisy: bool = False
) -> Verdict:
    """Judge one hold.

    Parameters: time_s, force_n: the hold, from its start (or the end of the transient that is to be left out) to where
    it ended, alpha_f F_s [N], shape (n,); hand_force_n: what the hand presses with [N], > 0; ended_early: a guard ended
    it; noisy: the link is random, so a trend has to be a factor of two to be believed.
    Raises: ValueError if the hold has fewer than two samples a window, or the hand's force is not positive.
    """
    if not hand_force_n > 0.0:
        raise ValueError(f"the hand's force in a hold is {hand_force_n} N, it must be > 0 N")
    finite = np.isfinite(force_n)
    if not finite.all():
        ended_early = True
        last = int(np.argmin(finite))
        time_s, force_n = time_s[:last], force_n[:last]
    if ended_early and len(time_s) < 2 * WINDOWS:
        return Verdict("diverged", None, float(np.ptp(force_n)) if len(force_n) else 0.0)
    if len(time_s) < 2 * WINDOWS:
        raise ValueError(f"a hold of {len(time_s)} samples is too short to be judged, {2 * WINDOWS} are needed")
    centres, sizes = window_sizes(time_s, force_n)
    late = slice(WINDOWS - _LATE_WINDOWS, None)
    growth, trend = growth_rate(centres[late], sizes[late], _FLOOR_SHARE * hand_force_n)
    last_size = float(sizes[-1])
    if ended_early:
        # it may have ended before the windows held a period each: then their sizes show a part of a swing
        return Verdict("diverged", growth if growth is not None and growth > 0.0 else None, last_size)
    change = growth * float(centres[-1] - centres[WINDOWS - _LATE_WINDOWS]) if growth is not None else 0.0
    clear = abs(change) > (_NOISY_CHANGE if noisy else _SUSTAINED_CHANGE) and abs(trend) >= _CLEAR_TREND
    if clear and change > 0.0:
        return Verdict("diverged", growth, last_size)
    dies_out = clear or growth is None or last_size <= SMALL_SHARE * hand_force_n
    return Verdict("stable" if dies_out else "limit_cycle", growth, last_size)


def window_sizes(time_s: Series, force_n: Series) -> tuple[Series, Series]:
    """Return the middle [s] of each window and the peak-to-peak [N] in it, shape (WINDOWS,) each."""
    edges = np.linspace(0, len(time_s), WINDOWS + 1).astype(int)
    parts = [slice(a, b) for a, b in pairwise(edges)]
    centres = np.array([0.5 * (time_s[part][0] + time_s[part][-1]) for part in parts])
    return centres, np.array([np.ptp(force_n[part]) for part in parts])


def growth_rate(time_s: Series, size_n: Series, floor_n: float) -> tuple[float | None, float]:
    """Return the slope [1/s] of log(size) over time, and how clear the trend is, -1 (falls throughout) to 1 (rises).

    Parameters: time_s, size_n, shape (n,); sizes up to floor_n count as nothing. The slope is the median over all pairs
    (Theil and Sen), because a window may miss the one burst of a slow limit cycle; the trend is Kendall's tau. A motion
    that has died out leaves no pairs: the slope is then unknown (None) and the trend 0.
    """
    alive = np.flatnonzero(size_n > floor_n)
    logs, times = np.log(size_n[alive]), time_s[alive]
    rises = [(logs[j] - logs[i], times[j] - times[i]) for i, j in combinations(range(len(alive)), 2)]
    if not rises:
        return None, 0.0
    slope = float(np.median([rise / run for rise, run in rises]))
    return slope, float(np.mean([np.sign(rise) for rise, _ in rises]))

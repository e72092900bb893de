"""Swings of a force: a motion that goes to and fro evenly, as the page of the view looks for one while it runs.

`services/viz_node/web/src/oscillation.ts` has the same rule for the last seconds of a live rig, and
`services/viz_node/web/test/swings.json` holds both to it. A turning point counts where the force comes back from it by
a least height. The motion swings in three whole turns that are even: each turn takes at most 1.5 times as long as the
one half a turn before and no less than 1 / 1.5 of it, and no way of it is more than four times another, so that a press
is no part of the swing that follows it. A turn is timed from the middle of a way to the middle of the way after the
next, where the force goes fast, because when it turns is vague where the tip is off the sample. Heights of two, four
and eight times the least are tried as well, so that a small ripple on a large swing hides neither.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

# at the hand: below this a swing of the force is not felt [N]
FELT_N = 0.3
TURNS = 3
_EVENNESS, _LIKENESS = 1.5, 4.0
# the page looks at 15 s, in which three slower turns have no room
_LONGEST_TURN_S = 5.0
# The force is looked at so often [1/s]; one sample alone, as where an answer is missing, does not count.
_RATE_HZ = 100.0
# Between two swings that are one, a turn or two were uneven.
_UNEVEN_TURNS = 2.0


class Swing(NamedTuple):
    """A stretch in which a force swings, from its first turning point to its last: the greatest way from peak to peak.

    frequency_hz: of the turns that go as far.
    """

    start_s: float
    end_s: float
    frequency_hz: float
    peak_to_peak_n: float


def swings_of(time_s: Series, force_n: Series) -> list[Swing]:
    """Return the stretches in which a force swings by at least FELT_N [N] from peak to peak.

    Args:
        time_s: Times [s], shape (n,), rising.
        force_n: Force [N] at those times, shape (n,).
    """
    is_finite = np.isfinite(force_n)
    times, values = _sampled(time_s[is_finite], force_n[is_finite])
    swings: list[Swing] = []
    height_n, places = FELT_N, turning_points(values, range(len(values)), FELT_N)
    while len(places) > 2 * TURNS + 1:
        swings += _even(times, values, places)
        height_n *= 2.0
        places = turning_points(values, places, height_n)
    return _joined(swings)


def turning_points(values: Sequence[float], places: Sequence[int], height: float) -> list[int]:
    """Return the places, of those given, from which a motion comes back by a height, and that at which it begins."""
    turns: list[int] = []
    rises: bool | None = None
    if not places:
        return turns
    low = high = places[0]
    for i in places:
        now = values[i]
        if now >= values[high]:
            high = i
        if now <= values[low]:
            low = i
        if rises is not False and now <= values[high] - height:
            turns.append(high)
            rises, low = False, i
        elif rises is not True and now >= values[low] + height:
            turns.append(low)
            rises, high = True, i
    return turns


def _sampled(time_s: Series, force_n: Series) -> tuple[list[float], list[float]]:
    """Return even times, and the force there: of each three samples in a row the middle one."""
    if len(time_s) < 2:
        return [], []
    grid = np.arange(time_s[0], time_s[-1] + 0.5 / _RATE_HZ, 1.0 / _RATE_HZ)
    held = force_n[np.searchsorted(time_s, grid + 1e-9, side="right") - 1]
    padded = np.concatenate([held[:1], held, held[-1:]])
    middle = np.median(np.stack([padded[:-2], held, padded[2:]]), axis=0)
    return grid.tolist(), middle.tolist()


def _even(times: Sequence[float], values: Sequence[float], places: Sequence[int]) -> list[Swing]:
    """Return the runs of turning points of which each whole turn takes about as long as the one before."""
    middles = [times[_crossing(values, first, last)] for first, last in pairwise(places)]
    turns = [after - before for before, after in zip(middles, middles[2:], strict=False)]
    ways = [abs(values[last] - values[first]) for first, last in pairwise(places)]
    alike = [max(ways[i : i + 3]) <= _LIKENESS * min(ways[i : i + 3]) for i in range(len(turns))]
    evened, first = [], 0
    for i in range(1, len(turns) + 1):
        is_even = i < len(turns) and 1.0 / _EVENNESS <= turns[i] / max(turns[i - 1], 1e-9) <= _EVENNESS
        if is_even and turns[i] <= _LONGEST_TURN_S and alike[i - 1] and alike[i]:
            continue
        # the turns first .. i - 1 lie between the points first .. i + 2
        if i + 2 - first > 2 * TURNS:
            turn_s = float(np.median(turns[first:i]))
            # before its first way and after its last the force may have stood for long
            begin_s = max(times[places[first]], middles[first] - 0.5 * turn_s)
            end_s = min(times[places[i + 2]], middles[i + 1] + 0.5 * turn_s)
            evened.append(Swing(begin_s, end_s, 1.0 / turn_s, max(ways[first : i + 2])))
        first = i
    return evened


def _crossing(values: Sequence[float], first: int, last: int) -> int:
    """Return the first place between two turning points at which half of the way is behind."""
    middle, sign = 0.5 * (values[first] + values[last]), 1.0 if values[last] > values[first] else -1.0
    return next((i for i in range(first, last) if sign * (values[i] - middle) >= 0.0), last)


def _joined(swings: Sequence[Swing]) -> list[Swing]:
    """Return the swings with those joined that overlap, or that a turn or two part; of the larger one the frequency."""
    joined: list[Swing] = []
    for swing in sorted(swings):
        if joined and swing.start_s - joined[-1].end_s <= _UNEVEN_TURNS / max(
            joined[-1].frequency_hz, swing.frequency_hz
        ):
            before = joined.pop()
            larger = max(before, swing, key=lambda one: one.peak_to_peak_n)
            swing = larger._replace(start_s=before.start_s, end_s=max(before.end_s, swing.end_s))
        joined.append(swing)
    return joined

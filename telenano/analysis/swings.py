"""Swings of a force: even oscillations, found by the same rule as on the page of a running rig.

`services/viz_node/web/src/oscillation.ts` has this rule for the last seconds of a live rig, and
`services/viz_node/web/test/swings.json` tests both. A turning point counts if the force returns from it by a least
height; a stroke is the motion between two turning points. A swing needs three whole turns that are even: each turn
takes at most 1.5 times as long as the one half a turn before, and at least 1 / 1.5 of it, and no stroke is more than
four times another, so that a press is not part of the swing that follows it. A turn is timed from the middle of a
stroke to the middle of the next but one, where the force changes fast, because turning points are vague while the tip
is off the sample. Twice, four and eight times the least height and so on are tried as well, so that a small ripple on
a large swing hides neither.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

# least peak-to-peak swing of the force that a hand feels [N]
FELT_N = 0.3
TURNS = 3
# greatest ratio of two successive turns of an even swing, either way [1]
_EVENNESS = 1.5
# greatest ratio of the longest to the shortest of three successive strokes [1]
_LIKENESS = 4.0
# longest turn [s]: the page examines 15 s, which has no room for three slower ones
_LONGEST_TURN_S = 5.0
# rate at which the force is sampled [1/s]; a single deviating sample, as where an answer is missing, does not count
_RATE_HZ = 100.0
# longest gap between two swings that count as one [turns]
_UNEVEN_TURNS = 2.0


class Swing(NamedTuple):
    """A stretch in which a force swings: start and end [s], frequency of its turns [Hz], and largest stroke [N].

    If several swings are joined, frequency and size are those of the largest.
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
    """Return those of the given indices from which a motion returns by a height, and the one at which it starts."""
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
    """Return even times [s], and the force there [N], as the median of each three samples in a row."""
    if len(time_s) < 2:
        return [], []
    grid = np.arange(time_s[0], time_s[-1] + 0.5 / _RATE_HZ, 1.0 / _RATE_HZ)
    held = force_n[np.searchsorted(time_s, grid + 1e-9, side="right") - 1]
    padded = np.concatenate([held[:1], held, held[-1:]])
    middle = np.median(np.stack([padded[:-2], held, padded[2:]]), axis=0)
    return grid.tolist(), middle.tolist()


def _even(times: Sequence[float], values: Sequence[float], places: Sequence[int]) -> list[Swing]:
    """Return the swings: runs of turning points in which turns and strokes are even, at indices `places`."""
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
            # The force may have been constant for long before the first stroke and after the last one.
            begin_s = max(times[places[first]], middles[first] - 0.5 * turn_s)
            end_s = min(times[places[i + 2]], middles[i + 1] + 0.5 * turn_s)
            evened.append(Swing(begin_s, end_s, 1.0 / turn_s, max(ways[first : i + 2])))
        first = i
    return evened


def _crossing(values: Sequence[float], first: int, last: int) -> int:
    """Return the first index between two turning points at which half of the stroke is done."""
    middle, sign = 0.5 * (values[first] + values[last]), 1.0 if values[last] > values[first] else -1.0
    return next((i for i in range(first, last) if sign * (values[i] - middle) >= 0.0), last)


def _joined(swings: Sequence[Swing]) -> list[Swing]:
    """Return the swings in order, joining those that overlap or are at most two turns apart."""
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

"""Swings of a force: a motion that goes to and fro evenly, as the page of the view looks for one while it runs.

`services/viz_node/web/src/oscillation.ts` has the same rule for the last seconds of a live rig, and
`services/viz_node/web/test/swings.json` holds both to it. A turning point counts where the force comes back from it by
a least height. The motion swings when three whole turns follow one another of which each takes at most 1.5 times as
long as the one before, and no less than 1 / 1.5 of it; a press is no part of the swing that follows it, because of two
ways that are one turn neither is more than four times the other. Heights of two, four and eight times the least are
tried as well, so that a small ripple on a large swing hides neither.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

# at the hand: below this nobody feels that a force swings [N]
FELT_N = 0.3
TURNS = 3
_EVENNESS, _LIKENESS = 1.5, 4.0
# the least and the greatest value of each so long [s] are looked at
_SPAN_S = 2.5e-3
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


def swings_of(time_s: Series, force_n: Series, least_n: float = FELT_N) -> list[Swing]:
    """Return the stretches in which a force swings by at least a way from peak to peak.

    Args:
        time_s: Times [s], shape (n,), rising.
        force_n: Force [N] at those times, shape (n,).
        least_n: The least way from peak to peak [N].
    """
    known = np.isfinite(force_n)
    times, values = _thinned(time_s[known], force_n[known])
    found: list[Swing] = []
    height_n = least_n
    times, values = turning_points(times, values, height_n)
    while len(values) > 2 * TURNS:
        found += _even(times, values)
        height_n *= 2.0
        times, values = turning_points(times, values, height_n)
    return _joined(found)


def turning_points(time_s: Sequence[float], value: Sequence[float], height: float) -> tuple[list[float], list[float]]:
    """Return times and values of the points from which a motion comes back by a height, and of where it begins."""
    times: list[float] = []
    values: list[float] = []
    rises: bool | None = None
    low = high = 0
    for i, now in enumerate(value):
        if now >= value[high]:
            high = i
        if now <= value[low]:
            low = i
        if rises is not False and now <= value[high] - height:
            turn, rises, low = high, False, i
        elif rises is not True and now >= value[low] + height:
            turn, rises, high = low, True, i
        else:
            continue
        times.append(time_s[turn])
        values.append(value[turn])
    return times, values


def _thinned(time_s: Series, force_n: Series) -> tuple[list[float], list[float]]:
    """Return the least and the greatest value of each short span, in the order in which they come."""
    if len(time_s) < 2:
        return time_s.tolist(), force_n.tolist()
    of = max(1, round(_SPAN_S * (len(time_s) - 1) / max(float(time_s[-1] - time_s[0]), _SPAN_S)))
    if of < 2:
        return time_s.tolist(), force_n.tolist()
    whole = len(time_s) // of * of
    spans = force_n[:whole].reshape(-1, of)
    first = np.arange(len(spans)) * of
    ends = np.sort(np.stack([first + spans.argmin(axis=1), first + spans.argmax(axis=1)]), axis=0)
    places = np.concatenate([ends.T.ravel(), np.arange(whole, len(time_s))])
    return time_s[places].tolist(), force_n[places].tolist()


def _even(times: Sequence[float], values: Sequence[float]) -> list[Swing]:
    """Return the runs of turning points of which each whole turn takes about as long as the one before."""
    turns = [after - before for before, after in zip(times, times[2:], strict=False)]
    ways = [abs(after - before) for before, after in pairwise(values)]
    are_alike = [max(there, back) <= _LIKENESS * min(there, back) for there, back in pairwise(ways)]
    found, first = [], 0
    for i in range(1, len(turns) + 1):
        is_even = i < len(turns) and 1.0 / _EVENNESS <= turns[i] / turns[i - 1] <= _EVENNESS
        if is_even and are_alike[i - 1] and are_alike[i]:
            continue
        # the turns first .. i - 1 lie between the points first .. i + 1
        if i + 1 - first >= 2 * TURNS:
            greatest = max(ways[first : i + 1])
            found.append(Swing(times[first], times[i + 1], 1.0 / float(np.median(turns[first:i])), greatest))
        first = i
    return found


def _joined(swings: Sequence[Swing]) -> list[Swing]:
    """Return the swings with those joined that overlap, or that a turn or two part; of the larger one the frequency."""
    found: list[Swing] = []
    for swing in sorted(swings):
        if found and swing.start_s - found[-1].end_s <= _UNEVEN_TURNS / found[-1].frequency_hz:
            before = found.pop()
            larger = max(before, swing, key=lambda one: one.peak_to_peak_n)
            swing = larger._replace(start_s=before.start_s, end_s=max(before.end_s, swing.end_s))
        found.append(swing)
    return found

"""Whether two versions differ in any of some figures, from pairs of measurements that were taken in turn.

    compared({"hand": [(12.1, 12.3), ...], "link": [...]})

A figure is measured of both versions one after the other, over and over, so that each pair gives a ratio and what the
machine did meanwhile is in both. Ratios that follow one another are alike where the machine was slow for a while, so
that they are averaged in blocks of several correlation times, and what is left of the correlation between blocks widens
the interval. It is Student's of the mean of the blocks, with as many degrees of freedom as there are ratios that do not
follow from one another, and with the chance of an error divided by the number of figures (C. E. Bonferroni, 1936), so
that the ratios of all figures are within their intervals at once, and fewer than 5 % of equal versions have a figure
that differs.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from telenano.analysis.intervals import student

Series = NDArray[np.float64]
# All figures are within their intervals with this chance: more than 95 %, because the correlation that the blocks
# follow from is itself estimated.
_SURE = 0.985
# A block has this number of correlation times, if there are then as many blocks as this.
_BLOCK_TIMES = 3.0
_FEWEST_BLOCKS = 20
# A ratio that is off by more than so many times the median deviation counts as one that is off by that.
_FURTHEST = 8.0


class Ratio(NamedTuple):
    """The ratio of a figure of the one version to that of the other, and the ends of its interval; nan: not known."""

    ratio: float
    low: float
    high: float

    @property
    def differs(self) -> bool:
        """Whether the versions differ by more than chance."""
        return math.isfinite(self.low) and not self.low <= 1.0 <= self.high

    def told(self) -> str:
        """Return it in words, for a line of a table."""
        if not math.isfinite(self.low):
            return f"{self.ratio:.3f} (no interval: take more pairs, as these are few or follow from one another)"
        return f"{self.ratio:.3f} ({self.low:.3f} to {self.high:.3f}{', which differs' if self.differs else ''})"


def shown(ratio: Ratio) -> dict[str, float | bool | None]:
    """Return it as values of JSON, which has no nan."""
    ends = {name: value if math.isfinite(value) else None for name, value in ratio._asdict().items()}
    return {**ends, "differs": ratio.differs}


def compared(pairs: Mapping[str, Sequence[tuple[float, float]]]) -> dict[str, Ratio]:
    """Compare two versions in all of some figures.

    With fewer than twenty pairs that do not follow from one another no interval is known.

    Args:
        pairs: Of each figure the measurements of both versions, above zero, in the order in which they were taken.
    """
    middles, calm, inside = {}, {}, {}
    for what, measured in pairs.items():
        logs = np.log([one / other for one, other in measured])
        middles[what] = float(np.median(logs))
        deviation = float(np.median(np.abs(logs - middles[what])))
        inside[what] = float(np.mean(np.abs(logs - middles[what]) <= _FURTHEST * deviation))
        calm[what] = np.clip(logs, middles[what] - _FURTHEST * deviation, middles[what] + _FURTHEST * deviation)
    time = _correlation_time(list(calm.values()))
    if min(map(len, calm.values())) / (1.0 + 2.0 * time) < _FEWEST_BLOCKS:
        return {what: Ratio(math.exp(middle), math.nan, math.nan) for what, middle in middles.items()}
    found = {}
    for what, logs in calm.items():
        means, length = _blocks(logs, time)
        # The blocks of a process with this correlation time have this share of the variance of a mean of them.
        kept = 1.0 + math.expm1(-length / time) / (length / time) if time else 1.0
        # What is off by more goes where the median goes, and is no measurement of its own (P. J. Huber, 1964).
        error = float(means.std(ddof=1)) / math.sqrt(kept * len(means)) / inside[what]
        freedom = math.floor(min(len(means), len(logs) / (1.0 + 2.0 * time))) - 1
        middle, wide = float(means.mean()), student(freedom, 1.0 - (1.0 - _SURE) / len(calm)) * error
        found[what] = Ratio(*(math.exp(value) for value in (middle, middle - wide, middle + wide)))
    return found


def _blocks(logs: Series, time: float) -> tuple[Series, int]:
    """Return the means of blocks of several correlation times, and of twenty blocks at least; and how long they are."""
    length = min(max(1, math.ceil(_BLOCK_TIMES * time)), len(logs) // _FEWEST_BLOCKS)
    count = len(logs) // length
    return np.asarray(logs[len(logs) - count * length :].reshape(count, length).mean(axis=1)), length


def _correlation_time(courses: Sequence[Series]) -> float:
    """Return the sum of the correlations at the lags of one pair and more, up to the first that could be chance.

    It is the mean of those of all figures, as one of them has too few pairs to show it, and the machine is the same.
    What the mean of a course takes away from its correlations is added again.
    """
    known = [course - course.mean() for course in courses]
    known = [course for course in known if course.any()]
    if not known:
        return 0.0
    count, total = min(map(len, known)), 0.0
    for lag in range(1, count // 3):
        share = float(np.mean([course[:-lag] @ course[lag:] / (course @ course) for course in known]))
        share += (1.0 + 2.0 * total) / count
        if share < 0.5 / math.sqrt(count * len(known)):
            break
        total += share
    return total

"""Test whether two versions differ in any of several quantities, from pairs of measurements taken in turn.

    compared({"hand": [(12.1, 12.3), ...], "link": [...]})

Each quantity is measured for both versions one after the other, repeatedly, so that each pair gives a ratio and the
load of the machine affects both. Consecutive ratios are correlated if the machine was slow for a while, so they are
averaged in blocks of several correlation times, and the remaining correlation between blocks widens the interval. The
interval is Student's for the mean of the blocks, with as many degrees of freedom as there are independent ratios. The
probability of an error is divided by the number of quantities (C. E. Bonferroni, 1936), so that the ratios of all
quantities are within their intervals at once, and fewer than 5 % of equal versions have a quantity that differs.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from telenano.analysis.intervals import student

Series = NDArray[np.float64]
# All quantities are within their intervals with this probability: more than 95 %, because the correlation time that
# determines the blocks is itself estimated.
_SURE = 0.985
# The length of a block in correlation times, if that leaves at least the number of blocks below.
_BLOCK_TIMES = 3.0
_FEWEST_BLOCKS = 20
# A ratio that is off by more than this many median deviations is clipped to that distance.
_FURTHEST = 8.0


class Ratio(NamedTuple):
    """The ratio of a quantity of one version to that of the other, and the ends of its interval (nan if unknown)."""

    ratio: float
    low: float
    high: float

    @property
    def differs(self) -> bool:
        """Whether the versions differ by more than chance."""
        return math.isfinite(self.low) and not self.low <= 1.0 <= self.high

    def told(self) -> str:
        """Return the ratio in words, for a line of a table."""
        if not math.isfinite(self.low):
            return f"{self.ratio:.3f} (no interval: take more pairs, as these are few or follow from one another)"
        return f"{self.ratio:.3f} ({self.low:.3f} to {self.high:.3f}{', which differs' if self.differs else ''})"


def shown(ratio: Ratio) -> dict[str, float | bool | None]:
    """Return the ratio as values of JSON, in which None stands for nan."""
    ends = {name: value if math.isfinite(value) else None for name, value in ratio._asdict().items()}
    return {**ends, "differs": ratio.differs}


def compared(pairs: Mapping[str, Sequence[tuple[float, float]]]) -> dict[str, Ratio]:
    """Compare two versions in several quantities.

    With fewer than twenty independent pairs no interval is known.

    Args:
        pairs: For each quantity the measurements of both versions, above zero, in the order in which they were taken.
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
        # For a process with this correlation time, the spread of the blocks has this share of the variance of their
        # mean.
        kept = 1.0 + math.expm1(-length / time) / (length / time) if time else 1.0
        # Clipped ratios follow the median and are no measurements of their own (P. J. Huber, 1964).
        error = float(means.std(ddof=1)) / math.sqrt(kept * len(means)) / inside[what]
        freedom = math.floor(min(len(means), len(logs) / (1.0 + 2.0 * time))) - 1
        middle, wide = float(means.mean()), student(freedom, 1.0 - (1.0 - _SURE) / len(calm)) * error
        found[what] = Ratio(*(math.exp(value) for value in (middle, middle - wide, middle + wide)))
    return found


def _blocks(logs: Series, time: float) -> tuple[Series, int]:
    """Return the means of blocks of several correlation times, at least twenty blocks, and their length in pairs."""
    length = min(max(1, math.ceil(_BLOCK_TIMES * time)), len(logs) // _FEWEST_BLOCKS)
    count = len(logs) // length
    return np.asarray(logs[len(logs) - count * length :].reshape(count, length).mean(axis=1)), length


def _correlation_time(courses: Sequence[Series]) -> float:
    """Return the sum of the correlations at lags of one pair and more, up to the first that could be chance.

    It is the mean over all quantities, because each has too few pairs to show it and the machine is the same. The bias
    from subtracting the mean of each course is corrected.
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

"""Test whether the halves of a log differ by more than chance, and estimate the correlation time of a line.

differing = [what for what, halves in compared_halves(log).items() if halves.differ]
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from telenano_lab.networks.line_log import LineLog, Segment
from telenano_lab.networks.line_sources import Column
from telenano_lab.networks.line_tally import Numbers, Tally, blocks_in, scale_of, statistics_of, tally_of

# The number of times that the blocks of a log are dealt to two halves, to find the differences that chance makes.
_DEALS = 300
# The share of chance differences within the interval: more than 95 %, because the correlation time that determines the
# blocks is itself an estimate.
_SURE = 0.97
# The length of a block in correlation times, unless a half then has fewer or more blocks than these.
_BLOCK_TIMES = 5.0
_FEWEST_BLOCKS = 6.0
_MOST_BLOCKS = 40.0
# Correlations count only up to the first that is smaller than this.
_LITTLE_CORRELATION = 0.05
# Delays are limited to this quantile of their log, so that a few stalls do not dominate a correlation.
COUNTED = 0.995


class Halves(NamedTuple):
    """A statistic of both halves of a log, and the greatest difference by chance; nan: unknown."""

    first: float
    second: float
    most_by_chance: float

    @property
    def differ(self) -> bool:
        """Whether the halves differ by more than chance."""
        return abs(self.second - self.first) > self.most_by_chance


def compared_halves(log: LineLog, seed: int = 0) -> dict[str, Halves]:
    """Compare the statistics of the halves of a log with those of halves to which chance deals the blocks.

    If the line is stationary, a block of one half could as well belong to the other, so that the differences of halves
    dealt anew are those of chance, with the uncertainty of both halves. A block is several correlation times long; the
    correlation that remains between blocks widens the differences. A statistic differs if its difference, in its own
    deviations, exceeds the greatest one of any statistic in 97 % of the deals, so that fewer than 5 % of stationary
    lines have any difference (P. H. Westfall, S. S. Young, Resampling-Based Multiple Testing, Wiley 1993).
    """
    scale = scale_of(log)
    first, second = log.halves()
    time_s, half_s = lasting_s(log)
    block_s = half_s / min(max(half_s / (_BLOCK_TIMES * time_s), _FEWEST_BLOCKS), _MOST_BLOCKS)
    tally = tally_of(LineLog((*first.segments, *second.segments), log.round_trip, log.resolution_s), scale, block_s)
    is_second = np.repeat([0, 1], [sum(blocks_in(part, block_s) for part in half.segments) for half in (first, second)])
    # The mean of a block of a process with this correlation time keeps this share of the variance.
    times = block_s / time_s
    kept = 1.0 + math.expm1(-times) / times
    draw = np.random.default_rng(seed)
    deals = [_of_halves(tally, draw.permutation(is_second)) for _ in range(_DEALS)]
    of_first, of_second = _of_halves(tally, is_second)
    apart = np.array([[two[what] - one[what] for what in of_first] for one, two in deals]) / math.sqrt(kept)
    known = ~np.isnan(apart)
    sizes = np.where(known, np.abs(apart), 0.0)
    deviations = np.sqrt((sizes**2).sum(axis=0) / np.maximum(known.sum(axis=0), 1))
    in_deviations = np.divide(sizes, deviations, out=np.zeros_like(sizes), where=deviations > 0.0)
    limit = float(np.quantile(in_deviations.max(axis=1), _SURE))
    most = np.where(known.any(axis=0), limit * deviations, np.nan).tolist()
    return {what: Halves(one, of_second[what], most[number]) for number, (what, one) in enumerate(of_first.items())}


def _of_halves(tally: Tally, is_second: Numbers) -> tuple[dict[str, float], dict[str, float]]:
    """Return the statistics of the blocks in the first half, and of those in the second."""
    return statistics_of(tally, 1 - is_second), statistics_of(tally, is_second)


def lasting_s(log: LineLog) -> tuple[float, float]:
    """Return the correlation time of a line, and the length of a half of its log [s]."""
    first, second = log.halves()
    half_s = sum(float(part.sent_s[-1]) for part in first.segments)
    return correlation_time_s((*first.segments, *second.segments), log.period_s), half_s


def correlation_time_s(parts: Sequence[Segment], period_s: float) -> float:
    """Return the time in which the correlation of delays and losses falls to 1/e [s], at least a period.

    It is half of the sum of the correlations at all lags in both directions, up to the first below a twentieth; for an
    exponential course this is its time constant. Each part has its own mean, so that a change between parts does not
    count as correlation.
    """
    delays = np.concatenate([part.delay_s for part in parts])
    high = float(np.nanquantile(delays, COUNTED))
    longest = period_s
    for series in (
        [np.minimum(part.delay_s, high) - np.nanmean(np.minimum(part.delay_s, high)) for part in parts],
        [np.isnan(part.delay_s) - np.isnan(part.delay_s).mean() for part in parts],
    ):
        found = sum(_correlations([np.nan_to_num(one) for one in series])) * period_s
        longest = max(longest, found)
    return float(f"{longest:.5g}")


def _correlations(series: Sequence[Column]) -> list[float]:
    """Return half of the correlation at lag 0, which is 1, and those at the lags after it up to the first small one."""
    longest = max(len(one) for one in series)
    size = 1 << (2 * longest - 1).bit_length()
    courses_of = [np.fft.irfft(np.abs(np.fft.rfft(one, size)) ** 2, size) for one in series]
    products = np.sum(courses_of, axis=0)[: max(longest // 4, 1)]
    if not products[0] > 0.0:
        return [0.5]
    shares = products / products[0]
    small = np.flatnonzero(shares < _LITTLE_CORRELATION)
    return [0.5, *shares[1 : int(small[0]) if len(small) else len(shares)].tolist()]

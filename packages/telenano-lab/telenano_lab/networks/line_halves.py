"""Whether the halves of a log of a line differ by more than chance, and how long what happens on it lasts.

differing = [what for what, halves in compared_halves(log).items() if halves.differ]
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from telenano_lab.networks.line_log import LineLog, Segment
from telenano_lab.networks.line_sources import Column
from telenano_lab.networks.line_tally import Numbers, Tally, blocks_in, scale_of, statistics_of, tally_of

# The blocks of a log are dealt to two halves this number of times, for what chance makes between them.
_DEALS = 300
# Of what chance makes, this share stays within the interval: more than 95 %, because the correlation time that the
# blocks follow from is itself estimated.
_SURE = 0.97
# A block has this number of correlation times, if a half then has as many blocks as this, and no more than that.
_BLOCK_TIMES = 5.0
_FEWEST_BLOCKS = 6.0
_MOST_BLOCKS = 40.0
# Correlations from the first that is smaller on count as none.
_LITTLE_CORRELATION = 0.05
# Delays count up to this share of those of their log, so that a few stalls are not all of a correlation.
COUNTED = 0.995


class Halves(NamedTuple):
    """A statistic of both halves of a log, and the difference that chance makes at most; nan: none is known."""

    first: float
    second: float
    most_by_chance: float

    @property
    def differ(self) -> bool:
        """Whether the halves differ by more than chance."""
        return abs(self.second - self.first) > self.most_by_chance


def compared_halves(log: LineLog, seed: int = 0) -> dict[str, Halves]:
    """Compare the statistics of the halves of a log, by blocks that chance deals to two halves.

    If the line is stationary, a block of the one half could as well be one of the other, so that the differences of
    halves that are dealt anew are those that chance makes, with the uncertainty of both halves. A block is as long as
    several correlation times; what is left of the correlation between blocks widens the differences. A statistic
    differs if its difference, in its own deviations, is greater than the greatest of any statistic in 97 % of the
    deals, so that fewer than 5 % of stationary lines have a difference at all (P. H. Westfall, S. S. Young,
    Resampling-Based Multiple Testing, Wiley 1993).
    """
    scale = scale_of(log)
    first, second = log.halves()
    time_s, half_s = lasting_s(log)
    block_s = half_s / min(max(half_s / (_BLOCK_TIMES * time_s), _FEWEST_BLOCKS), _MOST_BLOCKS)
    tally = tally_of(LineLog((*first.segments, *second.segments), log.round_trip, log.resolution_s), scale, block_s)
    is_second = np.repeat([0, 1], [sum(blocks_in(part, block_s) for part in half.segments) for half in (first, second)])
    # The blocks of a process with this correlation time have this share of the variance of a mean of them.
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
    """Return the statistics of the blocks that are of the first half, and of those that are of the second."""
    return statistics_of(tally, 1 - is_second), statistics_of(tally, is_second)


def lasting_s(log: LineLog) -> tuple[float, float]:
    """Return the correlation time of a line, and how long a half of its log is [s]."""
    first, second = log.halves()
    half_s = sum(float(part.sent_s[-1]) for part in first.segments)
    return correlation_time_s((*first.segments, *second.segments), log.period_s), half_s


def correlation_time_s(parts: Sequence[Segment], period_s: float) -> float:
    """Return the time in which the correlation of delays and losses falls to 1/e [s], at least that of a message.

    It is half of the sum of the correlations at all lags either way, up to the first below a twentieth: for an
    exponential course the time of that. Each part has its own mean, so that a change between parts is no correlation.
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
    """Return half of the one at lag 0, and the correlations at the lags after it, up to the first small one."""
    longest = max(len(one) for one in series)
    size = 1 << (2 * longest - 1).bit_length()
    courses_of = [np.fft.irfft(np.abs(np.fft.rfft(one, size)) ** 2, size) for one in series]
    products = np.sum(courses_of, axis=0)[: max(longest // 4, 1)]
    if not products[0] > 0.0:
        return [0.5]
    shares = products / products[0]
    small = np.flatnonzero(shares < _LITTLE_CORRELATION)
    return [0.5, *shares[1 : int(small[0]) if len(small) else len(shares)].tolist()]

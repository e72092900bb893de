"""Tally the data of a log that a fit needs in blocks of time, so that a resample of the blocks only costs sums.

A stall, a run of losses or a pair of neighbours belongs to the block in which it begins, even if it ends in the next.
If a resample cut a stall in two, the two short ones would make up most of the spread of the lengths.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano_lab.networks.line_log import LineLog, Segment
from telenano_lab.networks.line_sources import Column

Numbers = npt.NDArray[np.int64]
# Messages that arrive within this share of the sending period of each other arrive together.
_TOGETHER = 0.2
# A stall is longer than this number of periods.
_PERIODS = 2.0
# A stall is longer than this multiple of the distance from the median delay to the third quartile.
_SPREADS = 8.0
# The approximate length of the blocks for resampling.
BLOCK_S = 20.0
# The longest time over which the delay is compared with itself [s].
_LONGEST_LAG_S = 30.0
# A message overtakes the one before it if it arrives earlier by at least this.
_OVERTAKES_S = 1e-3


class Scale(NamedTuple):
    """The scale that separates stalls from usual delays: period, median delay, least length of a stall [s]."""

    period_s: float
    median_s: float
    stall_s: float


class Stall(NamedTuple):
    """The first message of a stall in its segment, the first after it, and its greatest delay above the median [s]."""

    first: int
    end: int
    late_s: float


class SortedDelays(NamedTuple):
    """Delays in ascending order [s], and the number of the block of each."""

    delay_s: Column
    block: Numbers

    def quantiles_s(self, weights: Numbers, shares: Sequence[float]) -> Column:
        """Return the quantiles of the delays, each block counted by its weight, with linear interpolation [s]."""
        counts = np.cumsum(weights[self.block])
        if not len(counts) or counts[-1] == 0:
            return np.full(len(shares), np.nan)
        places = np.asarray(shares) * (counts[-1] - 1)
        below = np.floor(places)
        low, high = (
            self.delay_s[np.searchsorted(counts, np.minimum(below + n, counts[-1] - 1), side="right")] for n in (0, 1)
        )
        return np.asarray(low + (places - below) * (high - low))


class Tally(NamedTuple):
    """A log in n blocks.

    usual, known: the delays outside of stalls, and all delays that are known. lags: distances in messages. usual_pairs
    of shape (lags, n, 6), pairs of shape (n, 6): the sums for a correlation, of messages at each lag outside of stalls,
    and of neighbours among all. stall_block, late_s, length_s and held, of shape (stalls,): the block of a stall, the
    greatest delay above the median, the length [s], and the number of messages held. seconds, messages, lost, runs and
    overtaken, of shape (n,): length [s], and the counts of messages, losses, runs of losses and overtakings.
    """

    period_s: float
    usual: SortedDelays
    known: SortedDelays
    lags: Numbers
    usual_pairs: npt.NDArray[np.float64]
    pairs: npt.NDArray[np.float64]
    stall_block: Numbers
    late_s: Column
    length_s: Column
    held: Numbers
    seconds: Column
    messages: Numbers
    lost: Numbers
    runs: Numbers
    overtaken: Numbers

    def once(self) -> Numbers:
        """Return weights that count each block once."""
        return np.ones(len(self.seconds), dtype=np.int64)

    def draws(self, seed: int, count: int) -> Iterable[Numbers]:
        """Yield the weights of this number of resamples of the blocks, with replacement."""
        draw, size = np.random.default_rng(seed), len(self.seconds)
        for _ in range(count):
            yield np.bincount(draw.integers(size, size=size), minlength=size)


def scale_of(log: LineLog) -> Scale:
    """Return the scale that separates stalls from usual delays on this line."""
    delays = np.concatenate([part.delay_s[~np.isnan(part.delay_s)] for part in log.segments])
    median_s, third_s = (float(value) for value in np.quantile(delays, (0.5, 0.75)))
    return Scale(log.period_s, median_s, max(_PERIODS * log.period_s, _SPREADS * (third_s - median_s)))


def stalls_of(part: Segment, scale: Scale) -> list[Stall]:
    """Return the stalls of a segment, in order.

    A stall is a run of messages that are late by more than half of the least length of a stall, or arrive together with
    the one before; one of them must be late by more than the whole length.
    """
    here = np.flatnonzero(~np.isnan(part.delay_s))
    if len(here) < 2:
        return []
    late_s = part.delay_s[here] - scale.median_s
    gaps_s = np.diff(part.sent_s[here] + part.delay_s[here], prepend=-np.inf)
    held = late_s > 0.5 * scale.stall_s
    # Each run of messages that are late or arrive together, from its first late one on.
    edges = np.diff((held | (gaps_s < _TOGETHER * scale.period_s)).astype(np.int8), prepend=0, append=0)
    stalls = []
    for first, end in zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True):
        begin = first + int(np.argmax(held[first:end]))
        most_s = float(late_s[begin:end].max())
        if most_s > scale.stall_s:
            stalls.append(Stall(int(here[begin]), int(here[end - 1]) + 1, most_s))
    return stalls


def blocks_in(part: Segment, block_s: float) -> int:
    """Return the number of blocks of about a length [s] in a segment: at least one, and not more than its messages."""
    return max(1, min(round(float(part.sent_s[-1]) / block_s), len(part.sent_s)))


def tally_of(log: LineLog, scale: Scale, block_s: float = BLOCK_S) -> Tally:
    """Return the tally of a log in blocks of about this length [s], at least one for each segment."""
    delays, blocks, is_usual, overtaken = [], [], [], []
    segment: list[Numbers] = []
    seconds: list[float] = []
    stalls: list[tuple[int, float, int, int]] = []
    for part in log.segments:
        pieces = blocks_in(part, block_s)
        edges_s = np.linspace(0.0, part.sent_s[-1], pieces + 1)
        block = len(seconds) + np.searchsorted(edges_s[1:-1], part.sent_s, side="right")
        seconds += np.diff(edges_s).tolist()
        usual = ~np.isnan(part.delay_s)
        arrived = np.flatnonzero(~np.isnan(part.delay_s))
        for stall in stalls_of(part, scale):
            usual[stall.first : stall.end] = False
            # Messages lost after its last one may have been sent before the stall ended.
            after = int(np.searchsorted(arrived, stall.end))
            until = int(arrived[after]) if after < len(arrived) else len(usual)
            stalls.append((int(block[stall.first]), stall.late_s, stall.end - stall.first, until - stall.first))
        goes_back = np.diff((part.sent_s + part.delay_s)[arrived]) < -_OVERTAKES_S
        overtaken.append(block[arrived[1:][goes_back]])
        delays.append(part.delay_s)
        blocks.append(block)
        is_usual.append(usual)
        segment.append(np.full(len(usual), len(segment)))
    delay_s, block, usual, segments = (np.concatenate(each) for each in (delays, blocks, is_usual, segment))
    count, lost = len(seconds), np.isnan(delay_s)
    begins = np.diff(segments, prepend=-1) > 0
    most = max(1, min(int(_LONGEST_LAG_S / scale.period_s), len(delay_s) - 1))
    lags = 2 ** np.arange(int(math.log2(most)) + 1)
    late_s = delay_s - scale.median_s

    def pairs(chosen: npt.NDArray[np.bool_], lag: int) -> npt.NDArray[np.float64]:
        # Both messages of a pair are in one segment.
        both = chosen[:-lag] & chosen[lag:] & (segments[:-lag] == segments[lag:])
        return _pair_sums(late_s[:-lag][both], late_s[lag:][both], block[:-lag][both], count)

    run_begins = lost & (begins | ~np.concatenate([[False], lost[:-1]]))
    stalled_s, spanned = (np.array([one[n] for one in stalls]) for n in (1, 3))
    return Tally(
        period_s=scale.period_s,
        usual=_sorted(delay_s[usual], block[usual]),
        known=_sorted(delay_s[~lost], block[~lost]),
        lags=lags,
        usual_pairs=np.array([pairs(usual, lag) for lag in lags.tolist()]),
        pairs=pairs(~lost, 1),
        stall_block=np.array([one[0] for one in stalls], dtype=np.int64),
        late_s=stalled_s,
        # If a message is late alone because others overtook it, the line did not stand still for all of its delay.
        length_s=np.minimum(stalled_s, spanned * scale.period_s),
        held=np.array([one[2] for one in stalls], dtype=np.int64),
        seconds=np.array(seconds),
        messages=np.bincount(block, minlength=count),
        lost=np.bincount(block[lost], minlength=count),
        runs=np.bincount(block[run_begins], minlength=count),
        overtaken=np.bincount(np.concatenate(overtaken), minlength=count),
    )


def correlation_of(pairs: npt.NDArray[np.float64], weights: Numbers) -> float:
    """Return the correlation of pairs from their sums, each block counted by its weight; nan if unknown."""
    count, first, second, squared, squared_too, product = (weights @ pairs).tolist()
    if count < 3.0:
        return math.nan
    spread, spread_too = squared - first * first / count, squared_too - second * second / count
    # A smaller difference of sums of squares is rounding.
    if spread <= 1e-12 * squared or spread_too <= 1e-12 * squared_too:
        return math.nan
    return float((product - first * second / count) / math.sqrt(spread * spread_too))


def statistics_of(tally: Tally, weights: Numbers) -> dict[str, float]:
    """Return the compared statistics of a log, each block counted by its weight; nan if there is none."""
    quantiles_ms = 1e3 * tally.known.quantiles_s(weights, (0.5, 0.99, 0.999))
    each = weights[tally.stall_block]
    late_s, held = np.repeat(tally.late_s, each), np.repeat(tally.held, each)
    return {
        "q50 [ms]": float(quantiles_ms[0]),
        "q99 [ms]": float(quantiles_ms[1]),
        "q99.9 [ms]": float(quantiles_ms[2]),
        "correlation of neighbours": correlation_of(tally.pairs, weights),
        "stalls per minute": 60.0 * len(held) / max(float(weights @ tally.seconds), 1e-9),
        "stall, median [ms]": 1e3 * float(np.median(late_s)) if len(held) else math.nan,
        "messages in one go": float(held.mean()) if len(held) else math.nan,
        "lost": int(weights @ tally.lost) / max(int(weights @ tally.messages), 1),
    }


def _sorted(delay_s: Column, block: Numbers) -> SortedDelays:
    order = np.argsort(delay_s, kind="stable")
    return SortedDelays(delay_s[order], block[order])


def _pair_sums(before: Column, after: Column, own: Numbers, count: int) -> npt.NDArray[np.float64]:
    terms = (np.ones(len(own)), before, after, before * before, after * after, before * after)
    return np.array([np.bincount(own, weights=term, minlength=count) for term in terms]).T

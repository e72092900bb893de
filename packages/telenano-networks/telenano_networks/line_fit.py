"""A model of the link fitted to a log of a line, and how far what it generates agrees with what was measured.

The model consists of settings that the link has: quantiles of the delay whose normal scores lose their correlation
over time, stalls that come at random, last for log-normal times and hold what arrives (so that it comes in one go),
and losses in runs. A stall is seen in a log as a message that is much later than usual, with those that are late after
it because they waited for it.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import special

from services.delay_node.config import parse_settings
from services.delay_node.engine import fates_of
from telenano_networks.line_log import LineLog, Segment
from telenano_networks.line_sources import Column

# Between two shares the quantiles are linear, and the tail needs them close.
_TAIL = (0.95, 0.97, 0.98, 0.985, 0.99, 0.995, 0.998, 0.999, 0.9995, 0.9998, 0.9999, 1.0)
SHARES = (0.0, 0.01, 0.05, *(n / 10 for n in range(1, 10)), *_TAIL)
# Messages of one go arrive within this share of the period at which they were sent.
_TOGETHER = 0.2
# A stall is longer than so many periods, and than so many times the distance from the median to the third quartile.
_PERIODS, _SPREADS = 2.0, 8.0
# A correlation of neighbours below this is none, and none is higher; with how many pairs and halvings it is sought.
_LEAST_CORRELATION, _MOST_CORRELATION, _PAIRS, _HALVINGS = 0.05, 0.9999, 20_000, 14
# With fewer stalls their spread is hardly known, and is not taken to be less than the assumed one.
_FEWEST_STALLS = 5
_LEAST_SPREAD, _ASSUMED_SPREAD = 0.02, 0.1
# Overtaking by less than this share is that of the clock.
_MOST_OVERTAKEN = 1e-3
# What a line holds while it stands still, in messages and bytes; no log of a few messages a second says it.
MOST_HELD, MOST_HELD_BYTES = 20_000, 4 << 20
_BLOCK_S, _RESAMPLES, _DRAWS = 20.0, 200, 25
_SIZE_BYTES = 200


class Scale(NamedTuple):
    """What tells a stall from the usual: the period of sending, median delay and least length of a stall [s]."""

    period_s: float
    median_s: float
    stall_s: float


@dataclass(frozen=True)
class LineModel:
    """A fitted line.

    quantiles: of the delay outside of stalls, (share, delay [s]); correlation_time_s: 0 without correlation;
    stalls_per_s, stall_s and spread: rate, mean length [s] and standard deviation of its logarithm;
    lost: share; run: mean number lost in a row; ordered: whether no message overtakes another.
    """

    quantiles: tuple[tuple[float, float], ...]
    correlation_time_s: float
    stalls_per_s: float
    stall_s: float
    spread: float
    lost: float
    run: float
    ordered: bool

    def settings(self) -> dict[str, Any]:
        """Return one direction of the link with this line."""
        jitter: dict[str, Any] = {
            "distribution": "table",
            "scale_s": 1.0,
            "quantiles": quantiles_text(self.quantiles),
        }
        if self.correlation_time_s > 0.0:
            jitter["correlation_time_s"] = self.correlation_time_s
        found: dict[str, Any] = {"jitter": jitter, "order": "link" if self.ordered else "any"}
        if self.stalls_per_s > 0.0:
            found["queue"] = {"limit_messages": MOST_HELD, "limit_bytes": MOST_HELD_BYTES}
            found["outage"] = {
                "mean_up_s": _rounded(1.0 / self.stalls_per_s),
                "mean_down_s": _rounded(self.stall_s),
                "down_spread": _rounded(self.spread),
                "mode": "hold",
            }
        if self.lost > 0.0:
            leave = min(1.0, 1.0 / self.run)
            found["gilbert_elliott"] = {"p": _rounded(leave * self.lost / (1.0 - self.lost)), "r": _rounded(leave)}
        return found

    def one_way(self) -> "LineModel":
        """Return one way of a round trip: half of each usual delay, half as many stalls and losses, each whole."""
        halved = tuple((share, 0.5 * value) for share, value in self.quantiles)
        return LineModel(
            halved, self.correlation_time_s, 0.5 * self.stalls_per_s, self.stall_s, self.spread,
            0.5 * self.lost, self.run, self.ordered,
        )  # fmt: skip


class Agreement(NamedTuple):
    """A statistic of the half that the fit has not seen: measured with its interval, generated, of the other half.

    halves_differ: the other half is not within the interval itself, and the model is held to the interval of that half.
    """

    what: str
    measured: float
    low: float
    high: float
    generated: float
    other_half: float
    halves_differ: bool
    agrees: bool


def quantiles_of(delays_s: Column) -> tuple[tuple[float, float], ...]:
    """Return the quantiles of delays that a model keeps, (share, delay [s])."""
    values = np.quantile(delays_s, SHARES).tolist()
    return tuple((share, _rounded(value)) for share, value in zip(SHARES, values, strict=True))


def quantiles_text(quantiles: Iterable[tuple[float, float]]) -> str:
    """Return quantiles, (share, delay [s]), as jitter.quantiles of the link takes them."""
    return ",".join(f"{share}:{_rounded(value)}" for share, value in quantiles)


def scale_of(log: LineLog) -> Scale:
    """Return what tells a stall from the usual on this line."""
    delays = np.concatenate([part.delay_s[~np.isnan(part.delay_s)] for part in log.segments])
    median_s, third_s = (float(value) for value in np.quantile(delays, (0.5, 0.75)))
    return Scale(log.period_s, median_s, max(_PERIODS * log.period_s, _SPREADS * (third_s - median_s)))


class Stall(NamedTuple):
    """The places of its messages in a segment (the last one is not of it), and by how much the latest came late [s]."""

    first: int
    end: int
    late_s: float


def stalls_of(part: Segment, scale: Scale) -> list[Stall]:
    """Return the stalls of a segment, in order.

    A stall is a run of messages that are late by half of the least length of a stall, or arrive together with the one
    before, of which one is late by the whole of it.
    """
    here = np.flatnonzero(~np.isnan(part.delay_s))
    if len(here) < 2:
        return []
    late_s = part.delay_s[here] - scale.median_s
    gaps_s = np.diff(part.sent_s[here] + part.delay_s[here], prepend=-np.inf)
    held = late_s > 0.5 * scale.stall_s
    # Each run of messages that are late or come together, from its first late one on.
    edges = np.diff((held | (gaps_s < _TOGETHER * scale.period_s)).astype(np.int8), prepend=0, append=0)
    found = []
    for first, end in zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True):
        begin = first + int(np.argmax(held[first:end]))
        most_s = float(late_s[begin:end].max())
        if most_s > scale.stall_s:
            found.append(Stall(int(here[begin]), int(here[end - 1]) + 1, most_s))
    return found


def fit(log: LineLog, scale: Scale | None = None) -> LineModel:
    """Return the model of a line."""
    scale = scale_of(log) if scale is None else scale
    usual, late_s, stalled_s = [], [], 0.0
    pairs: list[tuple[Column, Column]] = []
    for part in log.segments:
        is_usual = ~np.isnan(part.delay_s)
        for stall in stalls_of(part, scale):
            is_usual[stall.first : stall.end] = False
            # Of a message that comes late alone, because others overtook it, the line did not stand still so long.
            late_s.append(min(stall.late_s, (stall.end - stall.first) * scale.period_s))
            stalled_s += late_s[-1]
        usual.append(part.delay_s[is_usual])
        both = is_usual[:-1] & is_usual[1:]
        pairs.append((part.delay_s[:-1][both], part.delay_s[1:][both]))
    delays = np.sort(np.concatenate(usual))
    seconds = sum(float(part.sent_s[-1]) for part in log.segments)
    stall_s, spread = _lengths(np.array(late_s), scale.period_s)
    lost = np.concatenate([np.isnan(part.delay_s) for part in log.segments])
    runs = sum(_runs(np.isnan(part.delay_s)) for part in log.segments)
    return LineModel(
        quantiles_of(delays),
        _correlation_time(pairs, delays, scale.period_s),
        len(late_s) / max(seconds - stalled_s, scale.period_s) if late_s else 0.0,
        stall_s,
        spread,
        float(lost.mean()),
        float(lost.sum()) / max(runs, 1) if lost.any() else 1.0,
        _overtaken(log) < _MOST_OVERTAKEN,
    )


def _runs(lost: npt.NDArray[np.bool_]) -> int:
    """Return how often something was lost after what was not."""
    return int(lost[0]) + int((np.diff(lost.astype(np.int8)) == 1).sum())


def _lengths(late_s: Column, period_s: float) -> tuple[float, float]:
    """Return mean [s] and spread of the lengths of the stalls that are long enough to be seen.

    The first message that a stall held was sent up to a period after its begin, so that it is late by half a period
    less on average, and by the standard deviation of that time more or less. What is too short to be seen is in the
    quantiles of the usual delay, and is not made up for here.
    """
    if not len(late_s):
        return 0.0, 0.0
    logs = np.log(late_s + 0.5 * period_s)
    middle_s = math.exp(float(np.median(logs)))
    chance = period_s / math.sqrt(12.0) / middle_s
    deviation = float(logs.std(ddof=1)) if len(logs) > 1 else 0.0
    least = _LEAST_SPREAD if len(logs) >= _FEWEST_STALLS else _ASSUMED_SPREAD
    spread = math.sqrt(max(deviation**2 - chance**2, least**2))
    return middle_s * math.exp(0.5 * spread**2), spread


def _correlation_time(pairs: Sequence[tuple[Column, Column]], delays: Column, period_s: float) -> float:
    """Return the time in which the correlation of normal scores falls to 1/e [s], from that of neighbours; 0: none.

    The scores are given the correlation with which the delays, as their quantiles make them of scores, have that of the
    log.
    """
    before, after = (np.concatenate([pair[n] for pair in pairs]) for n in range(2))
    if len(before) < 3 or before.std() == 0.0 or after.std() == 0.0:
        return 0.0
    wanted = float(np.corrcoef(before, after)[0, 1])
    if wanted < _LEAST_CORRELATION:
        return 0.0
    first, fresh = np.random.default_rng(0).standard_normal((2, _PAIRS))
    quantiles = np.quantile(delays, SHARES)
    of_first = np.interp(special.ndtr(first), SHARES, quantiles)

    def correlation(rho: float) -> float:
        second = rho * first + math.sqrt(1.0 - rho * rho) * fresh
        return float(np.corrcoef(of_first, np.interp(special.ndtr(second), SHARES, quantiles))[0, 1])

    low, high = 0.0, _MOST_CORRELATION
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if correlation(middle) < wanted else (low, middle)
    return _rounded(-period_s / math.log(high))


def _overtaken(log: LineLog) -> float:
    late = total = 0
    for part in log.segments:
        arrived_s = (part.sent_s + part.delay_s)[~np.isnan(part.delay_s)]
        late += int((np.diff(arrived_s) < -1e-3).sum())
        total += len(arrived_s)
    return late / max(total, 1)


def generated(model: LineModel, log: LineLog, seed: int) -> LineLog:
    """Return what the link with this model would have done to the messages of a log."""
    settings = parse_settings({"seed": seed, "forward": model.settings()})
    segments = []
    begin_s = 0.0
    sent_s = []
    for part in log.segments:
        sent_s.append(begin_s + part.sent_s)
        begin_s += float(part.sent_s[-1]) + 60.0
    times_ns = [round(1e9 * time_s) for times_s in sent_s for time_s in times_s.tolist()]
    fates = fates_of(settings, "forward", "teleop/forward", times_ns, _SIZE_BYTES)
    delays = np.array([np.nan if fate.dropped else 1e-9 * fate.delay_ns for fate in fates])
    if log.resolution_s:
        delays = np.rint(delays / log.resolution_s) * log.resolution_s
    at = 0
    for part in log.segments:
        segments.append(Segment(part.sent_s, delays[at : at + len(part.sent_s)]))
        at += len(part.sent_s)
    return LineLog(tuple(segments), log.round_trip, log.resolution_s)


def statistics(log: LineLog, scale: Scale) -> dict[str, float]:
    """Return what is compared: quantiles [ms], correlation of neighbours, stalls, losses; nan where there is none."""
    parts = log.segments
    delays = np.concatenate([part.delay_s for part in parts])
    lost = np.isnan(delays)
    quantiles = np.quantile(delays[~lost], (0.5, 0.99, 0.999)) * 1e3 if not lost.all() else np.full(3, np.nan)
    found = [(stall, part) for part in parts for stall in stalls_of(part, scale)]
    minutes = sum(float(part.sent_s[-1]) for part in parts) / 60.0
    before = np.concatenate([part.delay_s[:-1] for part in parts])
    after = np.concatenate([part.delay_s[1:] for part in parts])
    both = ~np.isnan(before) & ~np.isnan(after)
    known = both.sum() > 2 and before[both].std() > 0.0 and after[both].std() > 0.0
    return {
        "q50 [ms]": float(quantiles[0]),
        "q99 [ms]": float(quantiles[1]),
        "q99.9 [ms]": float(quantiles[2]),
        "correlation of neighbours": float(np.corrcoef(before[both], after[both])[0, 1]) if known else math.nan,
        "stalls per minute": len(found) / max(minutes, 1e-9),
        "stall, median [ms]": float(np.median([stall.late_s for stall, _ in found])) * 1e3 if found else math.nan,
        "messages in one go": float(np.mean([stall.end - stall.first for stall, _ in found])) if found else math.nan,
        "lost": float(lost.mean()),
    }


def accept(log: LineLog, seed: int = 0) -> list[Agreement]:
    """Fit the first half of each segment and compare what the model generates with the second.

    The interval is that of a bootstrap of blocks of the second half, 95 %, and a statistic agrees inside of it. Where
    the first half is not inside of it either, no model of the first half can be: it agrees between the two halves, or
    inside the interval of the first.
    """
    scale = scale_of(log)
    first, second = log.halves()
    model = fit(first, scale)
    measured, other = statistics(second, scale), statistics(first, scale)
    draws = [statistics(generated(model, second, seed + n), scale) for n in range(_DRAWS)]
    samples, of_first = (
        [statistics(one, scale) for one in _draws_of(half, seed, _RESAMPLES)] for half in (second, first)
    )
    found = []
    for what, value in measured.items():
        # The median, because a single long stall in one of the draws is most of the mean of a late quantile.
        made = _middle([draw[what] for draw in draws])
        low, high = _interval([sample[what] for sample in samples])
        differ = not (math.isnan(other[what]) or math.isnan(low) or low <= other[what] <= high)
        near = low <= made <= high
        if differ and not near:
            low_of_first, high_of_first = _interval([sample[what] for sample in of_first])
            near = min(value, low_of_first) <= made <= max(value, high_of_first)
        # A half without a stall says nothing of their length.
        unknown = math.isnan(made) or math.isnan(value)
        found.append(Agreement(what, value, low, high, made, other[what], differ, unknown or near))
    return found


def parameters(model: LineModel) -> dict[str, float]:
    """Return the numbers of a model that an interval is stated of."""
    quantiles = dict(model.quantiles)
    return {
        "usual delay, q50 [ms]": 1e3 * quantiles[0.5],
        "usual delay, q99 [ms]": 1e3 * quantiles[0.99],
        "correlation time [ms]": 1e3 * model.correlation_time_s,
        "stalls per minute": 60.0 * model.stalls_per_s,
        "length of a stall [ms]": 1e3 * model.stall_s if model.stalls_per_s else math.nan,
        "spread of its logarithm": model.spread if model.stalls_per_s else math.nan,
        "lost": model.lost,
        "lost in a row": model.run if model.lost else math.nan,
    }


def intervals(log: LineLog, seed: int = 0, resamples: int = 200) -> dict[str, tuple[float, float]]:
    """Return the 95 % interval of each parameter, by a bootstrap of blocks of the log."""
    scale = scale_of(log)
    made = [parameters(fit(one, scale)) for one in _draws_of(log, seed, resamples)]
    return {what: _interval([one[what] for one in made]) for what in made[0]}


def _draws_of(log: LineLog, seed: int, count: int) -> list[LineLog]:
    blocks = []
    for part in log.segments:
        pieces = max(1, round(float(part.sent_s[-1]) / _BLOCK_S))
        edges = np.searchsorted(part.sent_s, np.linspace(0.0, part.sent_s[-1], pieces + 1)[1:-1])
        for times_s, delays_s in zip(np.split(part.sent_s, edges), np.split(part.delay_s, edges), strict=True):
            if len(times_s) > 2:
                blocks.append(Segment(times_s - times_s[0], delays_s))
    draw = np.random.default_rng(seed)
    drawn = [tuple(blocks[n] for n in draw.integers(len(blocks), size=len(blocks))) for _ in range(count)]
    return [LineLog(parts, log.round_trip, log.resolution_s) for parts in drawn]


def autocorrelation(log: LineLog, longest_s: float = 10.0) -> tuple[Column, Column]:
    """Return lags [s] and the correlation of the delays at them, for drawing."""
    period_s = log.period_s
    lags = np.unique(np.rint(np.geomspace(1, max(2.0, longest_s / period_s), 60)).astype(int))
    mean = float(np.nanmean(np.concatenate([part.delay_s for part in log.segments])))
    values = [_at_lag(log.segments, int(lag), mean) for lag in lags]
    return lags * period_s, np.array(values)


def _at_lag(parts: Sequence[Segment], lag: int, mean_s: float) -> float:
    product = square = 0.0
    pairs = singles = 0
    for part in parts:
        delays = part.delay_s - mean_s
        both = delays[:-lag] * delays[lag:] if len(delays) > lag else np.empty(0)
        product += float(np.nansum(both))
        pairs += int((~np.isnan(both)).sum())
        square += float(np.nansum(delays**2))
        singles += int((~np.isnan(delays)).sum())
    return product / pairs / (square / singles) if pairs and square > 0.0 else math.nan


def ages_s(log: LineLog, count: int = 20_000) -> Column:
    """Return how old the newest message that a reader has is, at times that are drawn from all of a log [s]."""
    found = []
    for part in log.segments:
        here = ~np.isnan(part.delay_s)
        if here.sum() < 2:
            continue
        sent_s, arrived_s = part.sent_s[here], part.sent_s[here] + part.delay_s[here]
        order = np.argsort(arrived_s, kind="stable")
        newest_s = np.maximum.accumulate(sent_s[order])
        at_s = np.linspace(arrived_s.min(), part.sent_s[-1], max(2, count // len(log.segments)))
        found.append(at_s - newest_s[np.searchsorted(arrived_s[order], at_s, side="right") - 1])
    return np.concatenate(found)


def lost_runs(log: LineLog) -> list[int]:
    """Return how many messages each run of losses has."""
    found = []
    for part in log.segments:
        edges = np.diff(np.isnan(part.delay_s).astype(np.int8), prepend=0, append=0)
        found += (np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)).tolist()
    return found


def _interval(values: Sequence[float]) -> tuple[float, float]:
    known = [value for value in values if not math.isnan(value)]
    return (float(np.quantile(known, 0.025)), float(np.quantile(known, 0.975))) if known else (math.nan, math.nan)


def _middle(values: Sequence[float]) -> float:
    known = [value for value in values if not math.isnan(value)]
    return float(np.median(known)) if known else math.nan


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")

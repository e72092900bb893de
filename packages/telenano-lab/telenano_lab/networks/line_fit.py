"""Fit a model of the link to a log of a line, and measure how far generated messages agree with the log.

The model consists of settings that the link has: quantiles of the delay whose normal scores lose their correlation over
time; stalls that begin at random, last for log-normal times and hold arriving messages (so that these come together);
and losses in runs. In a log, a stall appears as a message that is much later than usual, with the messages after it
that are late because they waited for it.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import special

from telenano.settings import LinkSettings
from telenano_lab.networks.line_draws import delays_ns
from telenano_lab.networks.line_halves import COUNTED, compared_halves
from telenano_lab.networks.line_log import LineLog, Segment
from telenano_lab.networks.line_sources import Column
from telenano_lab.networks.line_tally import Numbers, Scale, Tally, correlation_of, scale_of, statistics_of, tally_of

# Quantiles are linear between two shares, so the tail needs close shares.
_TAIL = (0.95, 0.97, 0.98, 0.985, 0.99, 0.995, 0.998, 0.999, 0.9995, 0.9998, 0.9999, 1.0)
SHARES = (0.0, 0.01, 0.05, *(n / 10 for n in range(1, 10)), *_TAIL)
# A correlation of neighbours below this counts as none.
_LEAST_CORRELATION = 0.05
# The greatest correlation of neighbours that is used.
_MOST_CORRELATION = 0.9999
# With a smaller share there is no second correlation time.
_LEAST_SHARE = 0.03
# Nor is there one if the time from neighbours alone misses the correlations by less than this (root mean square).
_LITTLE = 0.03
# The shortest time in which a correlation may fall to 1/e, in periods.
_SHORTEST_TIME = 0.3
# The longest such time, in multiples of the longest lag.
_LONGEST_TIME = 10.0
# The least factor by which the second time is shorter than the first.
_APART = 4.0
# The number of second times that the fit tries.
_SECOND_TIMES = 12
# With fewer stalls than this their spread is hardly known, and is at least the assumed one.
_FEWEST_STALLS = 5
# The least spread of the lengths of stalls, as a standard deviation of their logarithm.
_LEAST_SPREAD = 0.02
# The least spread with fewer stalls than _FEWEST_STALLS.
_ASSUMED_SPREAD = 0.1
# A smaller share of overtaking is due to the clock.
_MOST_OVERTAKEN = 1e-3
# Messages that a stalled line holds back. A log of a few messages per second cannot show the number.
MOST_HELD = 20_000
# Bytes that a stalled line holds back.
MOST_HELD_BYTES = 4 << 20
# The statistics of the model are taken from this number of generated logs.
_DRAWS = 25
# The size of messages in generated logs [bytes].
_SIZE_BYTES = 200
# The size of messages for the statistics of written settings [bytes].
_SENT_BYTES = 300
SPREAD = "spread of its logarithm"
# The lags at which the correlation of the delay is compared, if the log has this multiple of them.
_LAGS_S = (1.0, 10.0, 60.0)
_FEWEST_LAGS = 5.0
# Losses are compared over windows of this length, with at least this number of messages each, and this number of
# windows.
_WINDOW_S = 10.0
_FEWEST_IN_WINDOW = 5
_FEWEST_WINDOWS = 5
# Generated and measured values agree within this number of deviations of the generated ones, or within these
# differences.
_DEVIATIONS = 4.0
_NEARLY = {"correlation": 0.1, "10-s": 0.01, "deviation": 0.01}
# Among few windows, as many as this are chance.
_FEW_WINDOWS = 2.0
_VAGUE = 0.6


def _hermite(scores: Column, degree: int) -> npt.NDArray[np.float64]:
    """Return Hermite's polynomials of degrees 1 to `degree`, orthonormal for normal scores, shape (degree, scores)."""
    polynomials = [np.ones(len(scores)), scores]
    for n in range(1, degree):
        polynomials.append((scores * polynomials[n] - math.sqrt(n) * polynomials[n - 1]) / math.sqrt(n + 1))
    return np.array(polynomials[1:])


_SCORES = np.linspace(-5.5, 5.5, 1101)
_DEGREES = 96
_GRID_SHARES = special.ndtr(_SCORES)
_HERMITE = _hermite(_SCORES, _DEGREES)
_GRID_WEIGHTS = np.exp(-0.5 * _SCORES**2) / np.exp(-0.5 * _SCORES**2).sum()
# Correlations of scores, denser towards long times, and their powers from 1 to one above the degrees.
_CORRELATIONS = 1.0 - np.geomspace(1.0, 1.0 - _MOST_CORRELATION, 500)
_CORRELATION_POWERS = _CORRELATIONS[:, None] ** np.arange(1, _DEGREES + 2)


@dataclass(frozen=True)
class LineModel:
    """A fitted line.

    quantiles: of the delay outside of stalls, (share, delay [s]). correlation_time_s: 0 without correlation.
    second_time_s and second_share: a second correlation time, and the share of the variance of the scores that has it.
    stalls_per_s, stall_s and spread: rate, mean length [s], and standard deviation of the logarithm of the length.
    lost: share. run: mean number of messages lost in a row. ordered: whether no message overtakes another.
    """

    quantiles: tuple[tuple[float, float], ...]
    correlation_time_s: float
    second_time_s: float
    second_share: float
    stalls_per_s: float
    stall_s: float
    spread: float
    lost: float
    run: float
    ordered: bool

    def settings(self) -> dict[str, Any]:
        """Return the settings of one direction of the link for this line."""
        jitter: dict[str, Any] = {
            "distribution": "table",
            "scale_s": 1.0,
            "quantiles": quantiles_text(self.quantiles),
        }
        if self.correlation_time_s > 0.0:
            jitter["correlation_time_s"] = self.correlation_time_s
            if self.second_share > 0.0:
                jitter["second_correlation_time_s"] = self.second_time_s
                jitter["second_correlation_share"] = self.second_share
        section: dict[str, Any] = {"jitter": jitter, "order": "link" if self.ordered else "any"}
        if self.stalls_per_s > 0.0:
            section["queue"] = {"limit_messages": MOST_HELD, "limit_bytes": MOST_HELD_BYTES}
            section["outage"] = {
                "mean_up_s": _rounded(1.0 / self.stalls_per_s),
                "mean_down_s": _rounded(self.stall_s),
                "down_spread": _rounded(self.spread),
                "mode": "hold",
            }
        if self.lost > 0.0:
            leave = min(1.0, 1.0 / self.run)
            section["gilbert_elliott"] = {"p": _rounded(leave * self.lost / (1.0 - self.lost)), "r": _rounded(leave)}
        return section

    def ways(self, *, round_trip: bool, with_memory: bool = True, seed: int = 0) -> dict[str, dict[str, Any]]:
        """Return the settings of both directions of the link, which are written and judged.

        A line that was measured one way has the same settings in both. For round trips, all variation goes forward and
        half of the least delay backward: the sum then has the delays of the log, which two halves drawn independently
        would not have. Without memory, each message has a delay and a loss of the line drawn by itself.
        """
        sections = {"forward": self.settings(), "backward": self.settings()}
        if round_trip:
            least_s = _rounded(0.5 * max(self.quantiles[0][1], 0.0))
            rest = tuple((share, value - least_s) for share, value in self.quantiles)
            sections = {"forward": replace(self, quantiles=rest).settings(), "backward": {"delay_s": least_s}}
        if with_memory:
            return sections
        alone = without_memory(sections["forward"], seed)
        return {name: alone if "jitter" in way else way for name, way in sections.items()}


def sent(way: dict[str, Any], seed: int, minutes: int = 10) -> tuple[Column, Column]:
    """Return the times at which 120 000 messages were sent, evenly within these minutes, and their delays [ns]."""
    times_ns = range(0, minutes * 60 * 10**9, minutes * 500_000)
    settings = LinkSettings.of({"seed": seed, "forward": way})
    return np.array(times_ns, dtype=np.float64), delays_ns(settings, "teleop/forward", times_ns, _SENT_BYTES)


def without_memory(way: dict[str, Any], seed: int) -> dict[str, Any]:
    """Return settings with the delays and losses of a line, but drawn for each message by itself."""
    _, delay_ns = sent(way, seed)
    delays_s = 1e-9 * delay_ns[~np.isnan(delay_ns)]
    jitter = {"distribution": "table", "scale_s": 1.0, "quantiles": quantiles_text(quantiles_of(delays_s))}
    return {"jitter": jitter, "loss": {"probability": 1.0 - len(delays_s) / len(delay_ns)}}


class Agreement(NamedTuple):
    """A statistic of the half that the fit has not seen: measured with its interval, generated, and of the other half.

    halves_differ: the halves differ by more than chance, and the model agrees if it is between them.
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
    """Return the quantiles of delays that a model stores, (share, delay [s])."""
    values = np.quantile(delays_s, SHARES).tolist()
    return tuple((share, _rounded(value)) for share, value in zip(SHARES, values, strict=True))


def quantiles_text(quantiles: Iterable[tuple[float, float]]) -> str:
    """Return quantiles, (share, delay [s]), as the text of the link's jitter.quantiles."""
    return ",".join(f"{share}:{_rounded(value)}" for share, value in quantiles)


def fit(log: LineLog, scale: Scale | None = None) -> LineModel:
    """Return the model fitted to a log; `scale` is that of the log by default."""
    tally = tally_of(log, scale_of(log) if scale is None else scale)
    return _model(tally, tally.once())


def _model(tally: Tally, weights: Numbers) -> LineModel:
    """Return the model of a tally, with each block counted by its weight."""
    quantiles_s = tally.usual.quantiles_s(weights, SHARES)
    each = weights[tally.stall_block]
    lengths_s = np.repeat(tally.length_s, each)
    seconds = float(weights @ tally.seconds) - float(lengths_s.sum())
    stall_s, spread = _lengths(lengths_s, tally.period_s)
    messages, lost, runs = (int(weights @ counts) for counts in (tally.messages, tally.lost, tally.runs))
    return LineModel(
        tuple((share, _rounded(value)) for share, value in zip(SHARES, quantiles_s.tolist(), strict=True)),
        *memory_of(
            tally.lags, [correlation_of(pairs, weights) for pairs in tally.usual_pairs], quantiles_s, tally.period_s
        ),
        len(lengths_s) / max(seconds, tally.period_s),
        stall_s,
        spread,
        lost / messages,
        lost / max(runs, 1) if lost else 1.0,
        int(weights @ tally.overtaken) < _MOST_OVERTAKEN * max(messages - lost, 1),
    )


def _lengths(late_s: Column, period_s: float) -> tuple[float, float]:
    """Return mean [s] and spread of the lengths of the stalls that are long enough to be seen.

    The first message of a stall was sent up to a period after the stall began, so its delay is shorter than the stall
    by half a period on average, with the standard deviation of that time. Stalls that are too short to be seen are part
    of the quantiles of the usual delay, and are not added here.
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


def memory_of(
    lags: npt.NDArray[np.int64], wanted: Sequence[float], quantiles_s: Column, period_s: float
) -> tuple[float, float, float]:
    """Return the time in which the correlation of normal scores falls to 1/e, a second such time [s], and its share.

    The times t1 and t2 and the share b minimise the distance of (1 - b) exp(-t/t1) + b exp(-t/t2) from the correlations
    of the scores at all lags, in which neighbours count as much as all others together. If the time from neighbours
    alone fits as well, there is no second one. Without any correlation the time is 0. A correlation of less than a
    period is given 0.3 of it, because the log does not show it.

    Args:
        lags: Distances in messages, the first of which is 1, shape (n,).
        wanted: Correlations of the delays at these lags, nan if unknown.
        quantiles_s: Quantiles of the delay [s].
        period_s: Time between two messages [s].
    """
    is_measured = ~np.isnan(wanted)
    if not is_measured[0]:
        return 0.0, 0.0, 0.0
    scores, steps = correlation_of_scores(np.asarray(wanted)[is_measured], quantiles_s), lags[is_measured]
    weights = np.where(steps == 1, max(1.0, len(steps) - 1.0), 1.0)
    one = float(np.clip(scores[0], 1e-9, _MOST_CORRELATION))
    of_neighbours = _rounded(-period_s / math.log(one)) if wanted[0] >= _LEAST_CORRELATION else 0.0
    if math.sqrt(float((one**steps - scores) ** 2 @ weights / weights.sum())) <= _LITTLE or len(steps) < 3:
        return of_neighbours, 0.0, 0.0
    times = np.geomspace(_SHORTEST_TIME, _LONGEST_TIME * steps[-1], 150)
    courses = np.exp(-steps / times[:, None])
    best = (math.inf, 0.0, 0.0, 0.0)
    for second in np.geomspace(_SHORTEST_TIME, times[-1] / _APART, _SECOND_TIMES).tolist():
        fast = np.exp(-steps / second)
        apart = courses - fast
        square = np.maximum(apart**2 @ weights, 1e-12)
        shares = np.clip((apart @ (weights * (scores - fast))) / square, 0.0, 1.0)
        costs = ((shares[:, None] * apart + fast - scores) ** 2) @ weights
        costs[times < _APART * second] = math.inf
        place = int(np.argmin(costs))
        best = min(best, (float(costs[place]), float(times[place]), second, 1.0 - float(shares[place])))
    _, first, second, share = best
    if _LEAST_SHARE < share < 1.0 - _LEAST_SHARE:
        return _rounded(period_s * first), _rounded(period_s * second), _rounded(share)
    return of_neighbours, 0.0, 0.0


def correlation_of_scores(wanted: Column, quantiles_s: Column) -> Column:
    """Return the correlations of normal scores with which delays of these quantiles have the wanted correlations.

    With c_n the coefficients of the delay over Hermite's polynomials, which are orthonormal for normal scores, a
    correlation r of the scores becomes sum c_n^2 r^n / sum c_n^2 of the delays, both sums from n = 1 (Mehler).
    """
    delays_s = np.interp(_GRID_SHARES, SHARES, quantiles_s)
    delays_s -= _GRID_WEIGHTS @ delays_s
    variance = float(_GRID_WEIGHTS @ (delays_s * delays_s))
    powers = (_HERMITE @ (_GRID_WEIGHTS * delays_s)) ** 2 / variance
    # The next degree stands for all higher ones.
    powers = np.append(powers, max(0.0, 1.0 - float(powers.sum())))
    # A correlation below 0 becomes 0: no model of the link has delays that return after a time.
    return np.asarray(np.interp(wanted, _CORRELATION_POWERS @ powers, _CORRELATIONS))


def generated(ways: dict[str, dict[str, Any]], log: LineLog, seed: int) -> LineLog:
    """Return a log of the delays that the link with these settings would have given to the messages of a log."""
    segments = []
    begin_s = 0.0
    sent_s = []
    for part in log.segments:
        sent_s.append(begin_s + part.sent_s)
        begin_s += float(part.sent_s[-1]) + 60.0
    times_ns = np.rint(1e9 * np.concatenate(sent_s)).astype(np.int64)
    delays = delays_ns(
        LinkSettings.of({"seed": seed, "forward": ways["forward"]}), "teleop/forward", times_ns.tolist(), _SIZE_BYTES
    )
    if log.round_trip:
        there = np.flatnonzero(~np.isnan(delays))
        order = there[np.argsort(times_ns[there] + delays[there], kind="stable")]
        arrived_ns = np.rint(times_ns[order] + delays[order]).astype(np.int64).tolist()
        back = LinkSettings.of({"seed": seed + 1, "forward": ways["backward"]})
        delays[order] += delays_ns(back, "teleop/backward", arrived_ns, _SIZE_BYTES)
    delays *= 1e-9
    if log.resolution_s:
        delays = np.rint(delays / log.resolution_s) * log.resolution_s
    at = 0
    for part in log.segments:
        segments.append(Segment(part.sent_s, delays[at : at + len(part.sent_s)]))
        at += len(part.sent_s)
    return LineLog(tuple(segments), log.round_trip, log.resolution_s)


def courses(log: LineLog) -> dict[str, float]:
    """Return the behaviour of a line over seconds: correlations of the delay at lags, losses of windows; nan: unknown.

    Delays are limited to the 99.5 % quantile of their log, so that a few stalls do not dominate the correlation.
    """
    delays = np.concatenate([part.delay_s for part in log.segments])
    high = float(np.nanquantile(delays, COUNTED)) if (~np.isnan(delays)).any() else math.nan
    parts = [Segment(part.sent_s, np.minimum(part.delay_s, high)) for part in log.segments]
    mean, period_s = float(np.nanmean(np.minimum(delays, high))), log.period_s
    longest_s = max(float(part.sent_s[-1]) for part in log.segments)
    courses_of = {
        f"correlation at {lag_s:g} s": _at_lag(parts, max(1, round(lag_s / period_s)), mean)
        if period_s <= lag_s and _FEWEST_LAGS * lag_s <= longest_s
        else math.nan
        for lag_s in _LAGS_S
    }
    windows = [
        float(lost.mean())
        for part in log.segments
        for lost in np.split(
            np.isnan(part.delay_s), np.searchsorted(part.sent_s, np.arange(_WINDOW_S, part.sent_s[-1], _WINDOW_S))
        )
        if len(lost) >= _FEWEST_IN_WINDOW
    ]
    is_enough = len(windows) >= _FEWEST_WINDOWS
    courses_of["10-s windows with a fifth lost"] = float(np.mean(np.array(windows) > 0.2)) if is_enough else math.nan
    courses_of["deviation of the loss of 10-s windows"] = float(np.std(windows)) if is_enough else math.nan
    return courses_of


def _compared_courses(second: LineLog, first: LineLog, draws: Sequence[LineLog]) -> list["Agreement"]:
    """Compare the figures over seconds of a log with those of the model: within its scatter, or nearly equal.

    The interval comes from draws of the model, because a bootstrap of blocks of 20 s would cut longer events.
    """
    rows = []
    measured, other = courses(second), courses(first)
    made = [courses(one) for one in draws]
    windows = sum(float(part.sent_s[-1]) for part in second.segments) / _WINDOW_S
    nearly = {**_NEARLY, "10-s": max(_NEARLY["10-s"], _FEW_WINDOWS / windows)}
    for what, value in measured.items():
        made_values = np.array([one[what] for one in made if not math.isnan(one[what])])
        if math.isnan(value) or len(made_values) < 3:
            rows.append(Agreement(what, value, math.nan, math.nan, math.nan, other[what], False, True))
            continue
        wide = max(_DEVIATIONS * float(made_values.std(ddof=1)), nearly[what.split()[0]])
        middle = float(made_values.mean())
        near = abs(value - middle) <= wide
        rows.append(Agreement(what, value, middle - wide, middle + wide, middle, other[what], False, near))
    return rows


def statistics(log: LineLog, scale: Scale) -> dict[str, float]:
    """Return the compared statistics: quantiles [ms], correlation of neighbours, stalls, losses; nan if unknown."""
    tally = tally_of(log, scale)
    return statistics_of(tally, tally.once())


def accept(log: LineLog, seed: int = 0, *, with_memory: bool = True) -> list[Agreement]:
    """Fit the first half of each segment, and compare messages generated by its settings with the second half.

    The settings are those of `LineModel.ways`, with memory or without. The interval includes the uncertainty of both
    halves, and a statistic inside it agrees. If the halves differ by more than chance, no model of the first half can
    be that of the second: then it agrees if it lies between the two.
    """
    scale = scale_of(log)
    first, second = log.halves()
    ways = fit(first, scale).ways(round_trip=log.round_trip, with_memory=with_memory, seed=seed)
    made_logs = [generated(ways, second, seed + n) for n in range(_DRAWS)]
    draws = [statistics(one, scale) for one in made_logs]
    rows = []
    for what, halves in compared_halves(log, seed).items():
        value, other = halves.second, halves.first
        # The median is used, because one long stall in a draw could dominate the mean of a high quantile.
        made = _middle([draw[what] for draw in draws])
        low, high = value - halves.most_by_chance, value + halves.most_by_chance
        near = low <= made <= high or (halves.differ and min(value, other) <= made <= max(value, other))
        # A half without a stall shows nothing about their length.
        unknown = math.isnan(made) or math.isnan(value)
        near = near or (what.startswith("correlation") and abs(value - made) <= _NEARLY["correlation"])
        # An interval that contains nearly every correlation does not support the model.
        vague = what.startswith("correlation") and high - low > _VAGUE and abs(value - made) > 0.5 * _VAGUE
        agrees = unknown or (near and not vague)
        rows.append(Agreement(what, value, low, high, made, other, halves.differ, agrees))
    return rows + _compared_courses(second, first, made_logs)


def parameters(model: LineModel) -> dict[str, float]:
    """Return the parameters of a model for which an interval is stated."""
    quantiles = dict(model.quantiles)
    return {
        "usual delay, q50 [ms]": 1e3 * quantiles[0.5],
        "usual delay, q99 [ms]": 1e3 * quantiles[0.99],
        "correlation time [ms]": 1e3 * model.correlation_time_s,
        "second correlation time [ms]": 1e3 * model.second_time_s if model.second_share else math.nan,
        "share of the second": model.second_share if model.correlation_time_s else math.nan,
        "stalls per minute": 60.0 * model.stalls_per_s,
        "length of a stall [ms]": 1e3 * model.stall_s if model.stalls_per_s else math.nan,
        SPREAD: model.spread if model.stalls_per_s else math.nan,
        "lost": model.lost,
        "lost in a row": model.run if model.lost else math.nan,
    }


def intervals(log: LineLog, seed: int = 0, resamples: int = 1000) -> dict[str, tuple[float, float]]:
    """Return the 95 % interval of each parameter, by a bootstrap of blocks of the log.

    The percentiles are widened to those of Student's distribution for this number of blocks, because resamples of few
    blocks vary too little ("expanded percentile": Hesterberg, The American Statistician 69, 371, 2015). The spread of
    the stalls has at least the interval of a log-normal spread, by chi-square, because resamples of some dozens of
    stalls are too alike.
    """
    tally = tally_of(log, scale_of(log))
    drawn = [parameters(_model(tally, weights)) for weights in tally.draws(seed, resamples)]
    count, stalls = len(tally.seconds), len(tally.held)
    wide = math.sqrt(count / (count - 1)) * float(special.stdtrit(count - 1, 0.975)) if count > 1 else math.inf
    interval_of = {what: _interval([one[what] for one in drawn], float(special.ndtr(-wide))) for what in drawn[0]}
    if stalls > 1:
        spread = _model(tally, tally.once()).spread
        low, high = (spread * math.sqrt((stalls - 1) / special.chdtri(stalls - 1, share)) for share in (0.025, 0.975))
        low_drawn, high_drawn = interval_of[SPREAD]
        interval_of[SPREAD] = min(low, low_drawn), max(high, high_drawn)
    return interval_of


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
    """Return the age of the newest message at a reader [s], at times spread evenly over all of a log."""
    ages = []
    for part in log.segments:
        here = ~np.isnan(part.delay_s)
        if here.sum() < 2:
            continue
        sent_s, arrived_s = part.sent_s[here], part.sent_s[here] + part.delay_s[here]
        order = np.argsort(arrived_s, kind="stable")
        newest_s = np.maximum.accumulate(sent_s[order])
        at_s = np.linspace(arrived_s.min(), part.sent_s[-1], max(2, count // len(log.segments)))
        ages.append(at_s - newest_s[np.searchsorted(arrived_s[order], at_s, side="right") - 1])
    return np.concatenate(ages)


def lost_runs(log: LineLog) -> list[int]:
    """Return the number of messages in each run of losses."""
    runs = []
    for part in log.segments:
        edges = np.diff(np.isnan(part.delay_s).astype(np.int8), prepend=0, append=0)
        runs += (np.flatnonzero(edges == -1) - np.flatnonzero(edges == 1)).tolist()
    return runs


def _interval(values: Sequence[float], below: float = 0.025) -> tuple[float, float]:
    """Return the quantiles that cut off a share `below` at each end; nan if no value is known."""
    numbers = [value for value in values if not math.isnan(value)]
    return (
        (float(np.quantile(numbers, below)), float(np.quantile(numbers, 1.0 - below)))
        if numbers
        else (math.nan, math.nan)
    )


def _middle(values: Sequence[float]) -> float:
    numbers = [value for value in values if not math.isnan(value)]
    return float(np.median(numbers)) if numbers else math.nan


def _rounded(value: float) -> float:
    return float(f"{value:.5g}")

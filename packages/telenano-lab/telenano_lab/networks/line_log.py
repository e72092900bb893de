"""Read logs of a line: when each message was sent, and how long it took or that it was lost.

Four kinds of log are read: the output of `ping`, a table of times of sending and receiving (or of delays) with a line
of headings, a recording with the fate of each message on a network or the link, and a trace of the times at which a
line could deliver. A log is cut where its clock steps back or where nothing was sent for a time. A log is refused if
its units are not stated, its clocks disagree, or its delay has changed from begin to end.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from telenano.files import Column as TableColumn
from telenano.files import TextTable, decoded, read_regular
from telenano.timing import ClockLine
from telenano.wire import ConfigError
from telenano_lab.networks import ping_log
from telenano_lab.networks.line_sources import (
    Column,
    is_delivery_trace,
    of_mm_link,
    of_recording,
    through_delivery_trace,
)
from telenano_lab.networks.network_trace import Direction

UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# Fewer messages than this show nothing about rare events.
FEWEST = 300
# A log shorter than this shows nothing about rare events.
SHORTEST_S = 30.0
# A pause in sending is longer than this number of periods, and longer than _PAUSE_S.
_PAUSE_PERIODS = 20.0
_PAUSE_S = 1.0
# The range of the median delay of a line; another one has a wrong unit.
_SHORTEST_DELAY_S = 1e-6
_LONGEST_DELAY_S = 100.0
# The names of columns of times contain one of these.
_SENT = ("sent", "send", "pub", "tx")
_RECEIVED = ("rec", "sub", "rx", "arriv")
_TIMES = ("time", "ts")
# Words of a heading that mean a round trip or a delay, anywhere in it, and words that mean another quantity.
_ROUND_TRIP = re.compile(r"(?i)rtt|round|ping|(?:two|2).?way")
_DELAY = re.compile(r"(?i)delay|latenc|owd|one.?way")
_NO_DELAY = re.compile(r"(?i)drop|los[st]|rate|share|jitter|count|seq|dev|var|\bid\b")
_LOST = "lost"
_LARGEST_BYTES = 256_000_000
# A longer time between two messages means a wrong unit.
_LONGEST_PERIOD_S = 600.0
# A longer log means a wrong unit.
_LONGEST_LOG_S = 1e8
# A log is divided into this number of parts, after each of which a step of one of two clocks is sought.
_PARTS = 20
# The shortest delays change evenly if they are off a line by less than this share of their span, and in one step if it
# has more than this share of it.
_EVENLY, _IN_ONE_STEP = 0.25, 0.7
# The distance of an assumed lower bound of the clock from the shortest delays [ns]; it has no influence on the slope.
_BELOW_NS = 10**9
# With a greater share of rows that go back in time, the rows are not in the order of sending.
_MOST_BACK_SHARE = 0.01
# This number of rows may go back in time in any log.
_MOST_BACK = 3


@dataclass(frozen=True)
class Segment:
    """A part without a pause: sent_s, not decreasing from 0, and delay_s, nan if lost, of shape (n,) each [s]."""

    sent_s: Column
    delay_s: Column


@dataclass(frozen=True)
class LineLog:
    """The content of a log: its segments, whether the delays are round trips, and sentences about cuts.

    resolution_s: the step of which all delays are multiples [s], if it is so coarse that it shows, else 0.
    """

    segments: tuple[Segment, ...]
    round_trip: bool
    resolution_s: float = 0.0
    cuts: tuple[str, ...] = ()

    @property
    def period_s(self) -> float:
        """The median time between two sent messages [s]."""
        return float(np.median(np.concatenate([np.diff(part.sent_s) for part in self.segments])))

    def halves(self) -> tuple["LineLog", "LineLog"]:
        """Return the first and the second half in time of each segment."""
        both_halves: tuple[list[Segment], list[Segment]] = [], []
        for part in self.segments:
            middle = int(np.searchsorted(part.sent_s, 0.5 * part.sent_s[-1]))
            for half, place in zip(both_halves, (slice(None, middle), slice(middle, None)), strict=True):
                if len(part.sent_s[place]) > 1:
                    half.append(Segment(part.sent_s[place] - part.sent_s[place][0], part.delay_s[place]))
        return (
            LineLog(tuple(both_halves[0]), self.round_trip, self.resolution_s),
            LineLog(tuple(both_halves[1]), self.round_trip, self.resolution_s),
        )


def read_log(
    paths: Sequence[Path],
    unit: str | None = None,
    *,
    round_trip: bool = False,
    direction: Direction | None = None,
    period_s: float | None = None,
) -> LineLog:
    """Read logs of one line, each file as at least one segment.

    Args:
        paths: The files.
        unit: The unit of a table's columns whose headings state none.
        round_trip: Whether the delays of a table are round trips, like those of `ping` and those under a heading such
            as `rtt`.
        direction: The direction of a recording that is used; None takes `forward`.
        period_s: The time between two messages of a log that has no times [s].

    Raises:
        ConfigError: A log cannot be used, or no log needs one of the options; the message names file, line or column,
            or the option, and the remedy.
    """
    used: set[str] = set()
    segments: list[Segment] = []
    cuts: list[str] = []
    # Whether the delays of each log are round trips.
    trips: list[bool] = []
    for path in paths:
        try:
            parts, is_trip = _read(path, unit, direction or "forward", period_s, cuts, used)
        except (ValueError, OverflowError, MemoryError) as error:
            raise ConfigError(f"{path.name}: is not a log of a line that can be read: {error}") from error
        trips.append(is_trip or round_trip)
        for sent_s, delay_s in parts:
            segments += _cut(sent_s, delay_s, path.name, cuts)
    _check_used({"--unit": unit, "--direction": direction, "--period": period_s}, used, paths)
    if not segments:
        raise ConfigError(f"{', '.join(path.name for path in paths)}: is a log of ping without an answer")
    if any(trips) and not all(trips):
        raise ConfigError("logs of ping are of round trips; give tables beside them with --round-trip if they are too")
    log = LineLog(tuple(segments), any(trips), _resolution(segments), tuple(cuts))
    _check(log)
    return log


# The purpose of each option, for its refusal if no log needs it.
_FOR = {
    "--unit": "columns whose headings name no unit",
    "--direction": "recordings of a rig",
    "--period": "logs without times",
}


def _check_used(given: Mapping[str, object], used: set[str], paths: Sequence[Path]) -> None:
    """Refuse an option that none of the logs needs, because its user expects an effect."""
    for flag, value in given.items():
        if value is not None and flag not in used:
            names = ", ".join(path.name for path in paths)
            raise ConfigError(f"{names}: {flag} is for {_FOR[flag]}, and there are none in it; leave {flag} out")


Part = tuple[Column, Column]


def _read(
    path: Path, unit: str | None, direction: Direction, period_s: float | None, cuts: list[str], used: set[str]
) -> tuple[list[Part], bool]:
    """Return the parts of a log, and whether its delays are round trips; add the options that it needed to `used`."""
    if path.suffix == ".mcap":
        used.add("--direction")
        return [of_recording(path, direction, cuts)], False
    try:
        content = read_regular(path, _LARGEST_BYTES)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    text = decoded(content, path.name)
    if ping_log.is_ping_log(text):
        used.add("--period")
        log = ping_log.round_trips(text, path.name, period_s)
        cuts += log.remarks
        return [(np.array(rows)[:, 0], np.array(rows)[:, 1]) for rows in log.parts], True
    if (packets := of_mm_link(text, path.name, cuts)) is not None:
        return [packets], False
    if is_delivery_trace(text) and period_s is None:
        return [through_delivery_trace(text, path.name, cuts)], False
    table = TextTable.parse(content, path.name)
    cuts += [f"{path.name}: {remark}" for remark in table.remarks if "no number" not in remark]
    return _of_table(table, unit, period_s, cuts, used)


def _of_table(
    table: TextTable, unit: str | None, period_s: float | None, cuts: list[str], used: set[str]
) -> tuple[list[Part], bool]:
    name, columns = table.name, table.columns
    sent, received = table.find(*_SENT) or table.find(*_TIMES), table.find(*_RECEIVED)
    delay = _delay_in(columns)
    is_trip = delay is not None and _ROUND_TRIP.search(delay.name) is not None
    if period_s and delay is not None and (sent is None or sent.bad) and received is None:
        # Dates are not read as times, and the user states the time between two rows.
        sent = None
    elif len(columns) == 1 and (period_s or delay is not None):
        # The only column has delays.
        delay = columns[0]
        if period_s is None:
            raise ConfigError(f"{name}: has delays and no times; give the time between two messages by --period S")
        sent = None
    elif not any(column.title for column in columns):
        lone = "; of delays alone, give --period S" if len(columns) == 1 else ""
        raise ConfigError(f"{name}, line 1: has no headings; name the columns, such as sent_s,received_s{lone}")
    elif sent is None or (received is None and delay is None):
        raise ConfigError(
            f"{name}: has the columns {', '.join(column.title for column in columns)}; a column of times of sending"
            " (sent_s) or --period S is needed, and one of receiving (received_s) or of delays (delay_s), empty where a"
            " message was lost"
        )
    read = [one for one in (sent, received if delay is None else delay) if one is not None]
    used |= {"--period"} if sent is None else set()
    used |= {"--unit"} if any(not one.unit for one in read) else set()
    rows = len(table.lines)
    if not table.ends_whole and rows > 1 and not any("no whole row" in remark for remark in table.remarks):
        cuts.append(f"{name}: its last line has no end and may be a part of one; it is left out")
        rows -= 1
    lost_column = table.find(_LOST)
    lost = np.zeros(rows, dtype=bool) if lost_column is None else table.numbers(lost_column)[:rows] == 1.0
    if sent is None:
        sent_s = (period_s or 0.0) * np.arange(rows)
    else:
        begins, scale = table.numbers(sent)[:rows], _scale_of(sent, table, unit)
        if np.isnan(begins).any():
            raise ConfigError(f"{name}, line {table.lines[int(np.isnan(begins).argmax())]}: has no time of sending")
        # Only differences of times since the epoch keep their nanoseconds in a double.
        sent_s = (begins - begins[0]) * scale
    if delay is not None:
        delay_s = table.numbers(delay)[:rows] * _scale_of(delay, table, unit)
    else:
        assert received is not None and sent is not None
        ends, of_ends = table.numbers(received)[:rows], _scale_of(received, table, unit)
        same = of_ends == scale
        delay_s = (ends - begins) * scale if same else ends * of_ends - begins * scale
    early = (delay_s < 0.0) & ~lost
    if early.any():
        place = int(early.argmax())
        raise ConfigError(
            f"{name}, line {table.lines[place]}: was received {-delay_s[place]:.6g} s before it was sent; the two"
            " clocks disagree"
        )
    if is_trip and delay is not None:
        cuts.append(f"{name}: its heading {delay.title} means round trips")
    delay_s = np.where(lost, np.nan, delay_s)
    return [(np.asarray(sent_s, dtype=np.float64), delay_s)], is_trip


def _delay_in(columns: Sequence[TableColumn]) -> TableColumn | None:
    """Return the column of delays: one named a delay, else a round trip; among several, one with a unit of time."""
    for words in (_DELAY, _ROUND_TRIP):
        named = [one for one in columns if words.search(one.name) and not _NO_DELAY.search(one.name)]
        in_time = [one for one in named if (unit := one.known) and unit.powers == (("s", 1.0),)]
        if named:
            return (in_time or named)[0]
    return None


def _scale_of(column: TableColumn, table: TextTable, unit: str | None) -> float:
    named_unit = column.unit or unit
    if not named_unit:
        raise ConfigError(
            f"{table.name}: the column {column.title or 'of delays'} does not say its unit; call it"
            f" {column.title or 'delay'}_ms, or give --unit ms"
        )
    one = table.in_si(
        column._replace(values=np.ones(1), bad=None), ("s",), named_unit, "--unit" if not column.unit else ""
    )
    assert one is not None
    return float(one[0])


def _cut(sent_s: Column, delay_s: Column, name: str, cuts: list[str]) -> list[Segment]:
    if len(sent_s) < 2:
        raise ConfigError(f"{name}: holds {len(sent_s)} messages, which are too few")
    steps = np.diff(sent_s)
    pause_s = max(_PAUSE_S, _PAUSE_PERIODS * float(np.median(np.abs(steps))))
    back, paused = steps < 0.0, steps > pause_s
    if back.any():
        first = int(np.argmax(back))
        cuts.append(
            f"{name}: the clock stepped back {int(back.sum())} times, first after message {first + 1}; cut there"
        )
    if paused.any():
        cuts.append(f"{name}: nothing was sent for more than {pause_s:.3g} s {int(paused.sum())} times; cut there")
    if back.sum() > max(_MOST_BACK, _MOST_BACK_SHARE * len(sent_s)):
        raise ConfigError(
            f"{name}: the time of sending goes back {int(back.sum())} times; its rows are not in the order of sending,"
            " so sort them by it"
        )
    edges = [0, *(np.flatnonzero(back | paused) + 1).tolist(), len(sent_s)]
    return [
        Segment(sent_s[begin:end] - sent_s[begin], delay_s[begin:end])
        for begin, end in pairwise(edges)
        if end - begin >= 2
    ]


def _resolution(segments: Sequence[Segment]) -> float:
    delays = np.concatenate([part.delay_s[~np.isnan(part.delay_s)] for part in segments])
    for step_s in (1e-2, 1e-3, 1e-4):
        if len(delays) and np.abs(delays - np.rint(delays / step_s) * step_s).max() < 1e-3 * step_s:
            return step_s
    return 0.0


def _check(log: LineLog) -> None:
    count = sum(len(part.sent_s) for part in log.segments)
    seconds = sum(float(part.sent_s[-1]) for part in log.segments)
    if count < FEWEST or seconds < SHORTEST_S:
        raise ConfigError(
            f"{count} messages in {seconds:.3g} s are too few for a model, which needs {FEWEST} in {SHORTEST_S:g} s;"
            " is the unit of the times right?"
        )
    if seconds > _LONGEST_LOG_S or log.period_s > _LONGEST_PERIOD_S:
        raise ConfigError(
            f"{count} messages in {seconds:.3g} s, one in {log.period_s:.3g} s, are no log of a line that a model"
            " fits; is the unit of the times right?"
        )
    delays = np.concatenate([part.delay_s for part in log.segments])
    if np.isnan(delays).mean() > 0.5:
        raise ConfigError(
            f"{np.isnan(delays).mean():.0%} of the messages were lost; this is not a line that a model fits"
        )
    median_s = float(np.nanmedian(delays))
    if not _SHORTEST_DELAY_S <= median_s <= _LONGEST_DELAY_S:
        raise ConfigError(f"the median delay would be {median_s:.3g} s; is the unit of the column right?")
    for part in log.segments:
        # A step of a single clock shows in the times of sending. With two clocks the delays step, anywhere in the log;
        # the middle is checked first.
        places = [_PARTS // 2] if log.round_trip else sorted(range(1, _PARTS), key=lambda n: abs(n - _PARTS // 2))
        for place in places:
            _check_level(part, place / _PARTS)


def _check_level(part: Segment, share: float) -> None:
    """Refuse a part whose usual delays before and after this share of its time do not overlap."""
    at_s = share * float(part.sent_s[-1])
    place = int(np.searchsorted(part.sent_s, at_s))
    halves = [half[~np.isnan(half)] for half in (part.delay_s[:place], part.delay_s[place:])]
    if min(len(half) for half in halves) < FEWEST:
        return
    (low, below, high), (other_low, other, other_high) = (np.quantile(half, (0.1, 0.5, 0.9)) for half in halves)
    if low > other_high or other_low > high:
        raise ConfigError(
            f"the log is not stationary: its median delay is {1e3 * below:.4g} ms in its first {at_s:.4g} s and"
            f" {1e3 * other:.4g} ms after them, and hardly a delay of the one occurs in the other. {_change_in(part)}"
        )


def _change_in(part: Segment) -> str:
    """Return how the shortest delays of a part change over its time, in a sentence: evenly, in a step, or otherwise."""
    edges = np.linspace(0.0, float(part.sent_s[-1]), 4 * _PARTS + 1)
    places = np.searchsorted(part.sent_s, edges)
    blocks = [slice(low, high) for low, high in pairwise(places) if (~np.isnan(part.delay_s[low:high])).any()]
    at_ns = [round(1e9 * float(part.sent_s[block].mean())) for block in blocks]
    least_ns = [round(1e9 * float(np.nanmin(part.delay_s[block]))) for block in blocks]
    # One direction bounds the lead of the other clock from above; a bound from below at its level takes the slope only.
    bounds = list(zip(at_ns, least_ns, strict=True))
    line = ClockLine.through(bounds, [(at, least - _BELOW_NS) for at, least in bounds])
    whole = np.array(least_ns, dtype=np.float64)
    off = whole - np.array([line.at(at) for at in at_ns])
    span = float(np.ptp(whole))
    if line.drift and float(np.ptp(off)) < _EVENLY * span:
        return (
            f"Its shortest delays change evenly, by {1e6 * line.drift:+.3g} ppm"
            f" ({1e-6 * line.drift * at_ns[-1]:+.3g} ms in all), as where one of two clocks drifts against the other:"
            " set both by one time, or measure round trips"
        )
    place = int(np.argmax(np.abs(np.diff(whole))))
    if abs(whole[place + 1] - whole[place]) > _IN_ONE_STEP * span:
        return (
            f"Its shortest delay goes from {1e-6 * whole[place]:.4g} to {1e-6 * whole[place + 1]:.4g} ms in one step"
            f" near {1e-9 * at_ns[place + 1]:.4g} s: the way of the messages or a clock was changed there, which of"
            " them the delays do not say. Give the parts as logs of their own"
        )
    return "Why, the log does not say; give the parts between which it changes as logs of their own"

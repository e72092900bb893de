"""What was measured on a line: when each message was sent, and how long it took or that it was lost.

Four kinds of log are read: what `ping` printed, a table of times of sending and of receiving (or of delays) under a
line of headings, a recording with what a network or the link did to each message, and a trace of when a line could
deliver. A log is cut where its clock steps back or where nothing was sent for a time; a log whose units are not said,
whose clocks disagree, or whose delay is another one at its end than at its begin, is refused.
"""

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from proto.errors import ConfigError
from services.delay_node.models.traces import read_text
from telenano_networks import ping_log
from telenano_networks.line_sources import Column, Direction, is_delivery_trace, of_recording, through_delivery_trace

UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
# Fewer messages, or a shorter time, say nothing of what happens now and then.
FEWEST, SHORTEST_S = 300, 30.0
# A pause in sending is longer than so many periods, and than this.
_PAUSE_PERIODS, _PAUSE_S = 20.0, 1.0
# Outside of these no median delay of a line lies, and a unit is wrong.
_SHORTEST_DELAY_S, _LONGEST_DELAY_S = 1e-6, 100.0
_HEADING = re.compile(r"^(?P<name>.*?)(?:[ _]*[\[(](?P<bracket>ns|us|µs|ms|s)[\])]|_(?P<suffix>ns|us|ms|s))?$")
_SENT, _RECEIVED = ("sent", "send", "pub", "tx"), ("rec", "sub", "rx", "arriv")
_DELAY, _LOST = ("delay", "rtt", "latency"), "lost"
# A step of one of two clocks is sought after each of so many parts of a log.
_PARTS = 20
# Rows that go back in time more often than in this share, and so many times, are not in the order of sending.
_MOST_BACK_SHARE, _MOST_BACK = 0.01, 3


@dataclass(frozen=True)
class Segment:
    """A part without a pause: sent_s of shape (n,), not decreasing from 0 [s], and delay_s, nan where lost [s]."""

    sent_s: Column
    delay_s: Column


@dataclass(frozen=True)
class LineLog:
    """What a log holds: its segments, whether the delays are round trips, and what was cut, in sentences.

    resolution_s: what all delays are multiples of, where that is so coarse that it shows [s], else 0.
    """

    segments: tuple[Segment, ...]
    round_trip: bool
    resolution_s: float = 0.0
    cuts: tuple[str, ...] = ()

    @property
    def period_s(self) -> float:
        """The median time between two messages sent [s]."""
        return float(np.median(np.concatenate([np.diff(part.sent_s) for part in self.segments])))

    def halves(self) -> tuple["LineLog", "LineLog"]:
        """Return the first half in time of each segment, and the second."""
        found: tuple[list[Segment], list[Segment]] = [], []
        for part in self.segments:
            middle = int(np.searchsorted(part.sent_s, 0.5 * part.sent_s[-1]))
            for half, place in zip(found, (slice(None, middle), slice(middle, None)), strict=True):
                if len(part.sent_s[place]) > 1:
                    half.append(Segment(part.sent_s[place] - part.sent_s[place][0], part.delay_s[place]))
        return (
            LineLog(tuple(found[0]), self.round_trip, self.resolution_s),
            LineLog(tuple(found[1]), self.round_trip, self.resolution_s),
        )


def read_log(
    paths: Sequence[Path], unit: str | None = None, *, round_trip: bool = False, direction: Direction = "forward"
) -> LineLog:
    """Read logs of one line, each file as a segment of its own at least.

    `unit` is that of the columns of a table whose headings name none; `round_trip` says that the delays of a table are
    round trips, as those of `ping` are; `direction` is that of a recording which counts.

    Raises:
        ConfigError: A log cannot be used; the message names file, line or column, and what would be right.
    """
    segments: list[Segment] = []
    cuts: list[str] = []
    pinged = []
    for path in paths:
        if path.suffix == ".mcap":
            pinged.append(False)
            sent_s, delay_s = of_recording(path, direction, cuts)
        else:
            text = read_text(path) if not ping_log.is_ping_file(path) else path.read_text(encoding="utf-8")
            pinged.append(ping_log.is_ping_log(text))
            if pinged[-1]:
                sent_s, delay_s = _of_ping(text, path.name)
            elif is_delivery_trace(text):
                sent_s, delay_s = through_delivery_trace(text, path.name, cuts)
            else:
                sent_s, delay_s = _of_table(text, path.name, unit, cuts)
        if pinged[-1] and not len(sent_s):
            cuts.append(f"{path.name}: no packet was answered; it is left out, and the line was gone meanwhile")
        else:
            segments += _cut(sent_s, delay_s, path.name, cuts)
    if not segments:
        raise ConfigError(f"{', '.join(path.name for path in paths)}: is a log of ping without an answer")
    if any(pinged) and not all(pinged) and not round_trip:
        raise ConfigError("logs of ping are of round trips; give tables beside them with --round-trip if they are too")
    log = LineLog(tuple(segments), round_trip or any(pinged), _resolution(segments), tuple(cuts))
    _check(log)
    return log


def _of_ping(text: str, name: str) -> tuple[Column, Column]:
    answers = ping_log.round_trips(text, name)
    return np.array([row[0] for row in answers]), np.array([row[1] for row in answers])


def _of_table(text: str, name: str, unit: str | None, cuts: list[str]) -> tuple[Column, Column]:
    # Some programs put the mark of the order of bytes in front of their tables.
    lines = [line for line in text.removeprefix("\ufeff").splitlines() if line.strip() and not line.startswith("#")]
    if len(lines) > 1 and not text.endswith("\n"):
        cuts.append(f"{name}: its last line has no end and may be a part of one; it is left out")
        del lines[-1]
    rows = list(_fields(lines))
    headings = [heading.strip() for heading in rows[0]] if rows else []
    if not headings or any(_number(heading) is not None for heading in headings):
        raise ConfigError(f"{name}, line 1: has no headings; name the columns, such as sent_s,received_s")
    sent = _column(headings, _SENT)
    sent = _column(headings, ("time",)) if sent is None else sent
    received, delay = _column(headings, _RECEIVED), _column(headings, _DELAY)
    if sent is None or (received is None and delay is None):
        raise ConfigError(
            f"{name}: has the columns {', '.join(headings)}; a column of times of sending (sent_s) is needed, and one"
            " of receiving (received_s) or of delays (delay_s), empty where a message was lost"
        )
    scales = {at: _scale_of(headings[at], name, unit) for at in (sent, received, delay) if at is not None}
    lost = _column(headings, (_LOST,))
    sent_s, delay_s = np.empty(len(rows) - 1), np.empty(len(rows) - 1)
    origin: float | None = None
    for place, row in enumerate(rows[1:]):
        line = f"{name}, line {place + 2}"
        begin = _value(row, sent, line)
        if begin is None:
            raise ConfigError(f"{line}: has no time of sending")
        # Times of an epoch keep their nanoseconds only as differences.
        origin = begin if origin is None else origin
        sent_s[place] = (begin - origin) * scales[sent]
        is_lost = lost is not None and _value(row, lost, line) == 1.0
        took: float | None
        if delay is not None:
            given = _value(row, delay, line)
            took = None if given is None else given * scales[delay]
        else:
            assert received is not None
            end = _value(row, received, line)
            took = None if end is None else end * scales[received] - begin * scales[sent]
        if took is not None and took < 0.0 and not is_lost:
            raise ConfigError(f"{line}: was received {-took:.6g} s before it was sent; the two clocks disagree")
        delay_s[place] = np.nan if took is None or is_lost else took
    return sent_s, delay_s


def _fields(lines: Sequence[str]) -> Iterator[list[str]]:
    first = lines[0] if lines else ""
    delimiter = next((mark for mark in (",", ";", "\t") if mark in first), None)
    if delimiter is None:
        return (line.split() for line in lines)
    return iter(csv.reader(lines, delimiter=delimiter))


def _column(headings: Sequence[str], beginnings: Sequence[str]) -> int | None:
    return next((n for n, heading in enumerate(headings) if heading.lower().startswith(tuple(beginnings))), None)


def _scale_of(heading: str, name: str, unit: str | None) -> float:
    found = _HEADING.match(heading)
    own = None if found is None else found["bracket"] or found["suffix"]
    if own is None and unit is None:
        raise ConfigError(
            f"{name}: the column {heading} does not say its unit; call it {heading}_ms, or give --unit ms"
        )
    return UNITS_S["us" if own == "µs" else own or unit or "s"]


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _value(row: Sequence[str], column: int, line: str) -> float | None:
    if column >= len(row) or row[column].strip().lower() in ("", "nan", "none", "-"):
        return None
    value = _number(row[column])
    if value is None or not np.isfinite(value):
        raise ConfigError(f"{line}: {row[column]!r} is not a number")
    return value


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
    delays = np.concatenate([part.delay_s for part in log.segments])
    if np.isnan(delays).mean() > 0.5:
        raise ConfigError(f"{np.isnan(delays).mean():.0%} of the messages were lost; this is no line that a model fits")
    median_s = float(np.nanmedian(delays))
    if not _SHORTEST_DELAY_S <= median_s <= _LONGEST_DELAY_S:
        raise ConfigError(f"the median delay would be {median_s:.3g} s; is the unit of the column right?")
    for part in log.segments:
        # One clock that steps is seen as a step of sending; of two, the delays step, wherever in the log that is. The
        # middle comes first.
        places = [_PARTS // 2] if log.round_trip else sorted(range(1, _PARTS), key=lambda n: abs(n - _PARTS // 2))
        for place in places:
            _check_level(part, place / _PARTS)


def _check_level(part: Segment, share: float) -> None:
    """Refuse a part whose usual delays before this share of its time, and after it, have nothing in common."""
    at_s = share * float(part.sent_s[-1])
    place = int(np.searchsorted(part.sent_s, at_s))
    halves = [half[~np.isnan(half)] for half in (part.delay_s[:place], part.delay_s[place:])]
    if min(len(half) for half in halves) < FEWEST:
        return
    (low, below, high), (other_low, other, other_high) = (np.quantile(half, (0.1, 0.5, 0.9)) for half in halves)
    if low > other_high or other_low > high:
        raise ConfigError(
            f"the log is not stationary: its median delay is {1e3 * below:.4g} ms in its first {at_s:.4g} s and"
            f" {1e3 * other:.4g} ms after them, and hardly a delay of the one occurs in the other. The line changed"
            " (give the parts as logs of their own), or one of two clocks stepped"
        )

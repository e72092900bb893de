"""Read the output of `ping`: the round trips of a measured network.

The lines are those of the `ping` of Linux, BusyBox, BSD, macOS and Windows, and of `fping`, with the word for the time
in any language (`time=42 ms`, `Zeit=42ms`). `ping -D` prints the time of each answer, as do tools that put a date
before each line. Without times, packets are assumed to be sent evenly over the duration that the last lines state.
Windows prints no numbers: each line between its head and its statistics is a packet, and one without a time is lost.

Losses before the first and after the last answer are counted as well, from the numbers that other lines name (`no
answer yet for icmp_seq=7`) and from the number of transmitted packets. A new run in the same file, which has a head or
begins its numbers again, is a part of its own.
"""

import math
import re
from collections.abc import Iterator
from datetime import datetime
from typing import NamedTuple

from telenano.wire import ConfigError

_TIME = r"(?:\b[^\W\d]+ ?[=<]|\d bytes, )(?P<ms>\d{1,9}(?:[.,]\d{1,9})?) ?(?:ms|мс)"
_STAMP = r"\[(?P<stamp>\d{1,12}\.\d{1,12}|\d{4}-\d\d-\d\d[ T][\d:.]{5,20})\] "
_ANSWER = re.compile(rf"^(?:{_STAMP})?.*?{_TIME}", re.IGNORECASE)
# The last lines: the number of packets, and the time that all of them took.
_TOTAL = re.compile(r"^(\d{1,10}) packets transmitted(?:.* time (\d{1,12}) ?ms)?")
_NUMBER = re.compile(r"(?:\b(?:icmp_)?seq[= ]| : \[)(\d+)")
_HEAD = re.compile(rf"^(?:{_STAMP})?(?:PING|Pinging) ")
# Windows in any language: an answer ends with its TTL, and the head ends with a colon.
_OF_WINDOWS = re.compile(r"\bTTL=\d{1,3}\s*$")
# The unit may have any letters, because an older character set may have damaged it.
_WINDOWS_ANSWER = re.compile(r"[=<] ?(?P<ms>\d{1,9}) ?\S{1,4} +TTL=\d{1,3}\s*$")
_WINDOWS_HEAD = re.compile(r".*\d.*[:：]\s*$")
# No line of ping is longer than this.
_LONGEST_LINE = 500
# The sixteen bits of the number begin again after 65535.
_TURN = 65536
# A number that falls by more belongs to a new run, or to the next turn; answers overtake one another by less.
_FARTHEST_BACK = 1000
# A number may be ahead of the last one by this for each answered packet: a line that answers less often is of no use.
_MOST_UNANSWERED = 50
# In addition it may be ahead by this, however few packets were answered.
_MOST_AT_ONCE = 100_000
# The time that Windows waits after an answer.
_WINDOWS_PERIOD_S = 1.0
# The time that Windows waits for an answer.
_WINDOWS_PATIENCE_S = 4.0

Rows = list[tuple[float, float]]


class _Run:
    """One run of ping: by number, the time of sending [s], None if no line states it, and the round trip [s]."""

    def __init__(self) -> None:
        self.answers: dict[int, tuple[float | None, float]] = {}
        # The greatest number with an answer; the least and the greatest number in any line.
        self.greatest = self.last = -1
        self.first = math.inf
        self.has_head = False
        self.sent = 0
        self.took_s = 0.0
        # The line of the first answer without a time stamp.
        self.unstamped = 0

    def name(self, number: int) -> None:
        self.first, self.last = min(self.first, number), max(self.last, number)


class Trips(NamedTuple):
    """The parts of a log, each with time since its first packet and round trip of each packet [s]; and remarks."""

    parts: list[Rows]
    remarks: tuple[str, ...]


def is_ping_log(text: str) -> bool:
    """Return whether a text is the output of `ping`, by its first lines."""
    lines = [line for line in text[:20_000].splitlines()[:20] if len(line) <= _LONGEST_LINE]
    return any(_HEAD.match(line) or _ANSWER.match(line) or _WINDOWS_ANSWER.search(line) for line in lines)


def round_trips(text: str, name: str, period_s: float | None = None) -> Trips:
    """Return the round trips of each run of ping in a text, nan without an answer; runs without answers are left out.

    Args:
        text: The output of ping.
        name: The name of the log, for messages.
        period_s: The time between two packets of a log that states none [s].

    Raises:
        ConfigError: No line states the time, or a number cannot be that of a packet; the message names the line.
    """
    if any(_OF_WINDOWS.search(line) and not _NUMBER.search(line) for line in text.splitlines()):
        return _of_windows(text, name, period_s)
    parts, remarks = [], []
    for run in _runs(text, name):
        if not run.answers:
            remarks.append(f"{name}: no packet of a run of ping was answered; it is left out, and the line was gone")
            continue
        if run.unstamped and period_s:
            run.took_s, run.sent = period_s * max(run.last - 1, 1), max(run.last, 2)
        if run.unstamped and not run.took_s:
            raise ConfigError(
                f"{name}, line {run.unstamped}: has no time; let `ping -D` print one, give --period, or keep the last"
                " lines of the log, which say how long all took"
            )
        parts.append(_rows_of(run, name))
    if len(parts) > 1:
        remarks.append(f"{name}: has {len(parts)} runs of ping; each is a part of its own")
    return Trips(parts, tuple(remarks))


def _runs(text: str, name: str) -> Iterator[_Run]:
    run, turns = _Run(), 0
    for line, row in enumerate(text.splitlines(), start=1):
        if _HEAD.match(row):
            if run.has_head or run.last >= 0:
                yield run
            run, turns = _Run(), 0
            run.has_head = True
            continue
        if total := _TOTAL.match(row):
            run.sent, run.took_s = int(total[1]), 1e-3 * int(total[2] or 0)
            continue
        if len(row) > _LONGEST_LINE:
            continue
        answer, named = _ANSWER.match(row), _NUMBER.search(row)
        if "(DUP!)" in row or (answer is None and named is None):
            continue
        if named is None:
            raise ConfigError(f"{name}, line {line}: has no icmp_seq, by which a lost packet is known")
        if len(named[1]) > 10:
            raise ConfigError(f"{name}, line {line}: icmp_seq={named[1][:20]}… is the number of no packet")
        number = int(named[1]) + _TURN * turns
        if run.last >= 0 and number < run.last - _FARTHEST_BACK:
            if run.last % _TURN > _TURN - _FARTHEST_BACK and int(named[1]) < _FARTHEST_BACK:
                turns, number = turns + 1, number + _TURN
            elif number + _TURN - run.last < _FARTHEST_BACK:
                number += _TURN
        back = run.last - number
        if run.last >= 0 and (back > _FARTHEST_BACK or (answer and _begins_again(run, number, answer))):
            yield run
            run, turns, number = _Run(), 0, int(named[1])
        elif run.last >= 0 and -back > _most_ahead(run):
            raise ConfigError(
                f"{name}, line {line}: icmp_seq={named[1]} is {-back} packets after the one before, of a log with"
                f" {len(run.answers)} answers so far; give the parts as logs of their own"
            )
        run.name(number)
        if answer is None:
            continue
        trip_s = 1e-3 * float(answer["ms"].replace(",", "."))
        at_s = None if answer["stamp"] is None else _seconds(answer["stamp"], name, line) - trip_s
        if at_s is None and not run.unstamped:
            run.unstamped = line
        run.answers.setdefault(number, (at_s, trip_s))
        run.greatest = max(run.greatest, number)
    if run.has_head or run.last >= 0:
        yield run


def _most_ahead(run: _Run) -> int:
    return _MOST_AT_ONCE + _MOST_UNANSWERED * len(run.answers)


def _begins_again(run: _Run, number: int, answer: re.Match[str]) -> bool:
    """Return whether an answered number begins a new run: its stamp is later, which is not so for a repetition."""
    if number not in run.answers or answer["stamp"] is None or run.greatest - number < 2:
        return False
    return number <= run.first + 2


def _rows_of(run: _Run, name: str) -> Rows:
    numbers = sorted(run.answers)
    # Linux counts from 1; BSD and macOS count from 0, and name that number whether it is answered or not.
    first = min(int(run.first), 1) if run.has_head else int(run.first)
    last = max(run.last, first + run.sent - 1 if run.sent <= run.last - first + 1 + _most_ahead(run) else 0)
    steady_s = run.took_s / max(run.sent - 1, 1) if run.took_s else 0.0
    times = {number: run.answers[number][0] for number in numbers}
    if any(value is None for value in times.values()):
        times = {number: number * steady_s for number in numbers}
    seen = [(number, at_s) for number, at_s in times.items() if at_s is not None]
    (begin, begin_s), (end, end_s) = seen[0], seen[-1]
    period_s = (end_s - begin_s) / (end - begin) if end > begin else steady_s or 1.0
    if not 0.0 <= period_s < 1e5:
        raise ConfigError(f"{name}: its times go back from {begin_s:.6g} to {end_s:.6g} s")
    zero_s = begin_s - (begin - first) * period_s
    rows: Rows = [((number - first) * period_s, math.nan) for number in range(first, begin)]
    for (number, at_s), (after, after_s) in zip(seen, [*seen[1:], (last + 1, end_s + (last + 1 - end) * period_s)],
                                                strict=True):  # fmt: skip
        rows.append((at_s - zero_s, run.answers[number][1]))
        step_s = (after_s - at_s) / (after - number)
        rows += [(at_s - zero_s + n * step_s, math.nan) for n in range(1, after - number)]
    return rows


def _of_windows(text: str, name: str, period_s: float | None) -> Trips:
    """Return the packets of each run: consecutive lines with at least one answer."""
    parts: list[Rows] = []
    for block in re.split(r"\n[^\S\n]*\n", text.replace("\r\n", "\n")):
        lines = [line for line in block.splitlines() if line.strip() and len(line) <= _LONGEST_LINE]
        answers = [_WINDOWS_ANSWER.search(line) for line in lines]
        if not any(answers):
            continue
        begin = 0
        while answers[begin] is None and _WINDOWS_HEAD.match(lines[begin]):
            begin += 1
        at_s, rows = 0.0, []
        for answer in answers[begin:]:
            trip_s = math.nan if answer is None else 1e-3 * float(answer["ms"])
            rows.append((at_s, trip_s))
            at_s += (period_s or _WINDOWS_PERIOD_S) + (_WINDOWS_PATIENCE_S if answer is None else 0.0)
        parts.append(rows)
    after_s = (period_s or _WINDOWS_PERIOD_S) + _WINDOWS_PATIENCE_S
    remark = f"{name}: ping of Windows prints no times; one packet in {period_s or _WINDOWS_PERIOD_S:g} s is assumed"
    return Trips(parts, (f"{remark}, and the next {after_s:g} s after a lost one",))


def _seconds(stamp: str, name: str, line: int) -> float:
    # Only differences count, so no time zone is needed.
    try:
        if stamp.replace(".", "").isdecimal():
            return float(stamp)
        return datetime.fromisoformat(f"{stamp}+00:00").timestamp()
    except (ValueError, OverflowError) as error:
        raise ConfigError(f"{name}, line {line}: {stamp!r} is not a time") from error

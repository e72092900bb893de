"""The clock of the slave's site against the master's over a recording, and all stamps of a recording on one clock.

Two machines have two clocks. What the link measured of their difference is in the recording: `link/status` has it ten
times a second, with the bounds between which it lies, and `clock/pong` has when each question was sent and when it
arrived. The lines through these bounds have offset and drift (`telenano.timing.clock_fit`), a line for as long as
one fits.

The bounds are half the round trip apart from the estimate, because no exchange can tell a difference of the clocks from
ways that differ there and back. So the difference is taken off only where the clocks are shown to differ: it is beyond
its bound, they drift apart, or without it an answer would come before its question. One machine, or a link of 10 ms
there and 70 ms back, shows none of these.
"""

import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from itertools import islice, pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.recording.arrays import replay_shifts
from telenano.recording.clock_course import bounds_of, knots, mean_drift, stretches
from telenano.recording.messages import ChannelFilter, LeftOut, RecordedChannel, RecordedMessage, readable
from telenano.recording.multi_file import RecordingSource
from telenano.timing.clock_fit import Bound, Bounds
from telenano.wire.errors import RecordingError
from telenano.wire.nodes import LINK, name_of, site_of

Ints = npt.NDArray[np.int64]

_NS = 1_000_000_000
# The topics on clocks.
_STATUS = "link/status"
_NETWORK = "link/network"
_ANSWER = "clock/pong"
# A recording that is no longer than this is read as a whole.
_WHOLE_NS = 90 * _NS
# Windows of this length are read of a longer recording.
_WINDOW_NS = 2 * _NS
# The windows are this far apart at least.
_STEP_OF_WINDOWS_NS = 90 * _NS
# There are at most this number of windows.
_MOST_WINDOWS = 64
# In a window the tip's samples of this length of time are examined.
_CAUSALITY_NS = 2 * _NS
# They are examined in this number of windows.
_MOST_EXAMINED = 8
# At most this number of messages on clocks are kept, of some thousand in a recording.
_MOST_LOOKED = 100_000
# At most this number of parts are read besides the windows.
_MOST_SOUGHT = 256
# Of what is read one line is tried for this time at first.
_PIECE_NS = 4 * _NS
# A report belongs to the exchange that it agrees with to this [ns], because stamps are whole ns.
_SAME_NS = 2_000
# Two clocks drift apart in this time by less than the error of their stamps.
_STEP_NS = _NS // 1000
# An answer may precede its question by so much, because of the error of the stamps [ns].
_EARLY_NS = 1_000_000
# No two clocks are further apart than this [s]: some 300 years.
_LONGEST_S = 1e10
# This represents a delay of which nothing is known [ns].
_LONG_NS = 2**60


class SiteClock(NamedTuple):
    """What the slave's clock is ahead of the master's.

    offset_s: in the middle of the recording [s]; uncertainty_s: bound of its error [s]; drift: what it gains [s/s];
    applied: whether it is taken off the slave's stamps, and the reason. knots_ns: times by the slave's clock [ns], with
    ahead_s there [s]; a straight line between two, and two of one time where the clock was set.
    """

    offset_s: float
    uncertainty_s: float
    drift: float
    applied: bool
    reason: str
    knots_ns: tuple[int, ...]
    ahead_s: tuple[float, ...]

    def ahead_ns(self, stamps_ns: Ints) -> Ints:
        """Return what the slave's clock is ahead at its own times [ns], whether it is applied or not."""
        if len(self.knots_ns) == 1:
            return np.full(stamps_ns.shape, round(self.ahead_s[0] * _NS), dtype=np.int64)
        origin = self.knots_ns[0]
        x = np.array([knot - origin for knot in self.knots_ns], dtype=np.float64)
        at = (stamps_ns - origin).astype(np.float64)
        part = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
        ahead, widths = np.array(self.ahead_s), np.maximum(np.diff(x), 1.0)
        # Beyond the ends the first and the last line are extended.
        return np.asarray(np.rint((ahead[part] + np.diff(ahead)[part] / widths[part] * (at - x[part])) * _NS), np.int64)

    def one_ahead_ns(self, stamp_ns: int) -> int:
        """Return the same for one stamp."""
        return int(self.ahead_ns(np.array([stamp_ns], dtype=np.int64))[0])


class ClockShift:
    """What to add to one stamp of the slave's site after the other [ns]; 0 where nothing is taken off."""

    def __init__(self, clock: SiteClock | None) -> None:
        self._clock = clock if clock is not None and clock.applied else None
        self._first_ns, self._shift_ns = -_STEP_NS, 0

    @property
    def is_needed(self) -> bool:
        """Return whether the clocks differ."""
        return self._clock is not None

    def __call__(self, stamp_ns: int) -> int:
        """Return the shift of a stamp; within _STEP_NS it is the same."""
        if self._clock is not None and not 0 <= stamp_ns - self._first_ns < _STEP_NS:
            self._first_ns = stamp_ns - stamp_ns % _STEP_NS
            self._shift_ns = -self._clock.one_ahead_ns(self._first_ns)
        return self._shift_ns


class Timeline:
    """The stamps of all sources of a recording on one clock, the master's [ns].

    A source that was itself replayed beside live ones is shifted to the time of its replay, see `replay_shifts`.
    """

    def __init__(self, recording: RecordingSource, *, quick: bool = False) -> None:
        """Read what the clocks were; `quick` tells by the last report of each node alone whether it was replayed."""
        self.shifts = replay_shifts(recording, newest=quick)
        self.clock = read_site_clock(recording)

    def with_clock(self, clock: SiteClock | None) -> "Timeline":
        """Return the same with another clock of the slave's site."""
        other = Timeline.__new__(Timeline)
        other.shifts, other.clock = self.shifts, clock
        return other

    def times_ns(self, src: str, stamps_ns: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return stamps of a source on the master's clock, shape (n,)."""
        if src in self.shifts:
            return stamps_ns + self.shifts[src]
        if self._differs(src) and self.clock is not None and stamps_ns.size:
            return stamps_ns - self.clock.ahead_ns(stamps_ns)
        return stamps_ns

    def stamp_ns(self, src: str, time_ns: int) -> int:
        """Return what a source stamps at a time of the master's clock [ns]: the inverse of `times_ns`."""
        if src in self.shifts:
            return time_ns - self.shifts[src]
        if self._differs(src) and self.clock is not None:
            about_ns = time_ns + round(self.clock.offset_s * _NS)
            return time_ns + self.clock.one_ahead_ns(about_ns)
        return time_ns

    def _differs(self, src: str) -> bool:
        return self.clock is not None and self.clock.applied and is_of_slave(src)


def is_of_slave(src: str) -> bool:
    """Return whether a node stamps by the clock of the slave's site."""
    # The link's endpoint there belongs to a process at the master's.
    return site_of(src) == "slave" and name_of(src) != LINK


def read_site_clock(recording: RecordingSource) -> SiteClock | None:
    """Return the slave's clock as the link measured it; None where it was not measured."""
    on_clocks = _ClockMessages(recording, _windows(*recording.span_ns))
    judged = (_judged(on_clocks, topic) for topic in (_STATUS, _NETWORK))
    return next((clock for clock in judged if clock is not None), None)


def _windows(first_ns: int, last_ns: int) -> list[tuple[int, int]]:
    """Return the parts of a recording that are looked at [ns]: all of a short one."""
    length_ns = last_ns - first_ns
    if length_ns <= _WHOLE_NS:
        return [(first_ns, last_ns + 1)]
    count = min(_MOST_WINDOWS, 1 + math.ceil(length_ns / _STEP_OF_WINDOWS_NS))
    step_ns = (length_ns - _WINDOW_NS) // (count - 1)
    return [(first_ns + n * step_ns, first_ns + n * step_ns + _WINDOW_NS) for n in range(count)]


class _ClockMessages:
    """What is on clocks in the windows of a recording, of which each chunk is read once, and elsewhere if asked for."""

    def __init__(self, recording: RecordingSource, windows: list[tuple[int, int]]) -> None:
        self.windows, self._recording = windows, recording
        # whether times of reception are those of the master's clock
        self.is_masters = site_of(recording.metadata.get("recording", {}).get("node", "")) == "master"
        examined = windows[:: math.ceil(len(windows) / _MOST_EXAMINED)]
        self.examined = [(first_ns, min(last_ns, first_ns + _CAUSALITY_NS)) for first_ns, last_ns in examined]
        self._messages = sorted(islice(self._found(), _MOST_LOOKED), key=_received_ns)
        self._more = _MOST_SOUGHT

    def _found(self) -> Iterator[RecordedMessage]:
        for piece in self._recording.pieces(_WINDOW_NS, 0):
            if any(piece.has(*window) for window in self.windows):
                for message in piece.recording.select(_is_on_clocks, blocks=piece.blocks):
                    windows = self.examined if _is_tip(message.channel) else self.windows
                    if any(first_ns <= message.log_ns < last_ns for first_ns, last_ns in windows):
                        yield message

    def select(self, wanted: ChannelFilter, first_ns: int, last_ns: int) -> Iterable[RecordedMessage]:
        """Return the messages of wanted channels in a part [ns]; none any more where very many were asked for."""
        if any(first <= first_ns and last_ns <= last for first, last in self.windows):
            bounds = (bisect_left(self._messages, at_ns, key=_received_ns) for at_ns in (first_ns, last_ns))
            return [message for message in self._messages[slice(*bounds)] if wanted(message.channel)]
        self._more -= 1
        return self._recording.select(wanted, first_ns, last_ns) if self._more >= 0 else ()


class _Report(NamedTuple):
    """What a report says of the clocks; answer: when the newest answer was sent and received [ns], None if untold."""

    t_ns: int
    offset_s: float
    uncertainty_s: float
    answer: tuple[int, int] | None


def _reports(on_clocks: _ClockMessages, topic: str, window: tuple[int, int]) -> Iterator[_Report]:
    """Yield the valid reports of a window, those that the master's end made."""
    reports = on_clocks.select(lambda channel: channel.topic == topic and channel.via == "direct", *window)
    for message, fields in readable(reports, LeftOut()):
        clock = fields.get("clock")
        if topic == _NETWORK and fields.get("direction") != "backward":
            continue
        if clock is None or not clock["valid"]:
            continue
        offset_s, uncertainty_s = clock["offset_s"], clock["uncertainty_s"]
        if abs(offset_s) + abs(uncertainty_s) < _LONGEST_S:
            sent_ns, received_ns = fields.get("answer_sent_ns"), fields.get("answer_received_ns")
            answer = (sent_ns, received_ns) if isinstance(sent_ns, int) and isinstance(received_ns, int) else None
            yield _Report(message.publish_ns, offset_s, uncertainty_s, answer)


def _piece(on_clocks: _ClockMessages, topic: str, window: tuple[int, int]) -> Bounds | None:
    """Return the bounds in a window: from above by the questions, or else by the reports, and from below by these."""
    reports = list(_reports(on_clocks, topic, window))
    upper = _questions(on_clocks, window)
    if not upper:
        # Reports alone are as good as the best of them.
        reports = sorted(reports, key=lambda report: report.uncertainty_s)[:1]
        upper = [(report.t_ns, round((report.offset_s + report.uncertainty_s) * _NS)) for report in reports]
    lower = [(r.answer[1], r.answer[0] - r.answer[1]) for r in reports if r.answer is not None]
    return bounds_of(upper, lower or _reported_lower_bounds(reports, upper))


def _reported_lower_bounds(reports: list[_Report], upper: list[Bound]) -> list[Bound]:
    """Return the lower bounds of reports that name no answer, as those of datagrams: each of an exchange before it."""
    asked = {round(ahead_ns / _SAME_NS): asked_ns for asked_ns, ahead_ns in upper}
    bounds = []
    for report in reports:
        place = round((report.offset_s + report.uncertainty_s) * _NS / _SAME_NS)
        made = (asked[near] for near in (place, place - 1, place + 1) if near in asked)
        bounds.append((next(made, report.t_ns), round((report.offset_s - report.uncertainty_s) * _NS)))
    return bounds


def _questions(on_clocks: _ClockMessages, window: tuple[int, int]) -> list[tuple[int, int]]:
    """Return when questions were sent by the master's clock [ns], and how long they took by two clocks [ns]."""
    questions = []
    answers = on_clocks.select(lambda c: c.topic == _ANSWER and is_of_slave(c.src), *window)
    for _, fields in readable(answers, LeftOut()):
        questions.append((fields["ping_t_ns"], fields["received_ns"] - fields["ping_t_ns"]))
    return questions


def _judged(on_clocks: _ClockMessages, topic: str) -> SiteClock | None:
    pieces = _pieces(on_clocks, topic)
    if not pieces:
        return None
    parts = stretches(pieces)
    course = knots(parts, lambda first_ns, last_ns: _piece(on_clocks, topic, (first_ns, last_ns)))
    drift = mean_drift(parts)
    middle_ns = (course[0][0] + course[-1][0]) // 2
    clock = SiteClock(
        offset_s=0.0,
        uncertainty_s=max(0.0, *(0.5 * part.line.round_trip_ns / _NS for part in parts)),
        drift=drift,
        applied=False,
        reason="",
        knots_ns=tuple(at_ns for at_ns, _ in course),
        ahead_s=tuple(ahead_ns / _NS for _, ahead_ns in course),
    )
    clock = clock._replace(offset_s=clock.one_ahead_ns(middle_ns) / _NS)
    is_beyond = max(map(abs, clock.ahead_s)) > clock.uncertainty_s
    early_s, early_without_s = _earliest_s(on_clocks, clock)
    limit_s = _EARLY_NS / _NS
    if set_back_s := _set_back_s(on_clocks, topic):
        return clock._replace(reason=f"the clock of the recording was set back by {set_back_s:.4g} s within it")
    if early_s < -limit_s <= early_without_s:
        words = f"{_spoken(clock.offset_s)} was measured, but then an answer would come {-early_s:.3g} s too early"
        return clock._replace(reason=words)
    if is_beyond:
        words = f"the slave's clock is {_spoken(clock.offset_s)}, which is known to {clock.uncertainty_s:.2g} s"
    elif early_without_s < -limit_s:
        words = f"by the stamps as they are an answer came {-early_without_s:.3g} s before its question"
    elif drift != 0.0:
        words = f"the clocks drift apart by {1e6 * drift:.3g} ppm"
    else:
        words = (
            f"{_spoken(clock.offset_s)} is within the {clock.uncertainty_s:.2g} s that half the round trip leaves open"
        )
        return clock._replace(reason=words)
    return clock._replace(applied=True, reason=words)


def _set_back_s(on_clocks: _ClockMessages, topic: str) -> float:
    """Return by how much the master's clock was set back [s]: a later report has an earlier stamp; 0 if it was not.

    Nothing is said where a number comes twice, because the node was then started again.
    """

    def is_masters(channel: RecordedChannel) -> bool:
        return channel.topic == topic and channel.via == "direct" and not is_of_slave(channel.src)

    messages = [message for window in on_clocks.windows for message in on_clocks.select(is_masters, *window)]
    stamps = {message.seq: message.publish_ns for message in messages}
    if len(stamps) < len(messages):
        return 0.0
    steps_ns = (before - after for before, after in pairwise(stamps[seq] for seq in sorted(stamps)))
    return max(0, *steps_ns, 0) / _NS


def _pieces(on_clocks: _ClockMessages, topic: str) -> list[Bounds]:
    """Return the bounds in windows, of a long one in parts; there is a report in one of them."""
    parts = [
        (first_ns, min(first_ns + _PIECE_NS, end_ns))
        for begin_ns, end_ns in on_clocks.windows
        for first_ns in range(begin_ns, end_ns, _PIECE_NS)
    ]
    return [piece for part in parts if (piece := _piece(on_clocks, topic, part)) is not None]


def _spoken(offset_s: float) -> str:
    return f"{abs(offset_s):.4g} s {'ahead' if offset_s >= 0.0 else 'behind'}"


def _earliest_s(on_clocks: _ClockMessages, clock: SiteClock) -> tuple[float, float]:
    """Return by how much the earliest of what crossed the link came after it was sent [s], with the offset and without.

    Below zero it came before. There: from a sample of the hand to the state of the tip that obeys it; back: from the
    stamp of that state to its reception, where the recorder is at the master's site.
    """
    stamps, there, back = [], [], []
    for window in on_clocks.examined:
        for message in on_clocks.select(_is_tip, *window):
            hand_ns = _hand_ns(message)
            stamps.append(message.publish_ns)
            there.append(message.publish_ns - hand_ns if hand_ns else _LONG_NS)
            back.append(message.log_ns - message.publish_ns if on_clocks.is_masters else _LONG_NS)
    if not stamps:
        return math.inf, math.inf
    ahead_ns = clock.ahead_ns(np.array(stamps, dtype=np.int64))
    ways = np.array(there, dtype=np.int64), np.array(back, dtype=np.int64)
    shifted = min(int((ways[0] - ahead_ns).min()), int((ways[1] + ahead_ns).min()))
    return shifted / _NS, min(int(ways[0].min()), int(ways[1].min())) / _NS


def _is_on_clocks(channel: RecordedChannel) -> bool:
    return channel.topic in (_STATUS, _NETWORK, _ANSWER) or _is_tip(channel)


def _received_ns(message: RecordedMessage) -> int:
    return message.log_ns


def _is_tip(channel: RecordedChannel) -> bool:
    return channel.topic == "afm/state" and channel.via == "direct" and is_of_slave(channel.src)


def _hand_ns(message: RecordedMessage) -> int:
    try:
        hand_ns = message.fields().get("hand_t_ns", 0)
    except RecordingError:
        return 0
    return hand_ns if isinstance(hand_ns, int) else 0

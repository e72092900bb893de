"""Estimate of the slave's clock against the master's over a recording, to put all stamps on the master's clock.

Two machines have two clocks. The recording contains the link's measurements of their difference: `link/status` reports
it ten times a second, with bounds, and `clock/pong` has the times at which each question was sent and received. Lines
fitted between these bounds give offset and drift (`telenano.timing.clock_fit`), each for as long as it fits.

A process counts its time on from the clock that it read at its start. A site that begins again after its clock was set
therefore has another offset, and the recording has a run for each (`telenano.recording.clock_course`). The time at
which a message was received says to which run its stamp belongs, because a clock that was set back has times twice.

The bounds are half the round trip away from the estimate, because no exchange can distinguish a clock difference from
unequal delays there and back. The difference is therefore corrected only if it is proven: it exceeds its bound, the
clocks drift apart, or without the correction an answer would precede its question. One machine, or a link with 10 ms
there and 70 ms back, fulfils none of these.
"""

import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from itertools import islice, pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.recording.arrays import replay_shifts
from telenano.recording.clock_course import Run, bounds_of, mean_drift, runs, split
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
# A recording up to this length is read as a whole.
_WHOLE_NS = 90 * _NS
# Length of the windows that are read of a longer recording.
_WINDOW_NS = 2 * _NS
# Greatest distance between the starts of two windows, unless there are `_MOST_WINDOWS`.
_STEP_OF_WINDOWS_NS = 90 * _NS
# Fewest windows, which are about as long together as a recording that is read as a whole, and most.
_FEWEST_WINDOWS = 40
_MOST_WINDOWS = 64
# Length of the part of a window in which the tip's samples are examined for causality.
_CAUSALITY_NS = 2 * _NS
# Most windows in which they are examined.
_MOST_EXAMINED = 8
# Most messages on clocks that are kept; a recording has some thousand.
_MOST_LOOKED = 100_000
# Most parts that are read besides the windows, in search of the time at which a clock was set.
_MOST_SOUGHT = 256
# Length of a piece, the shortest part for which a line is fitted.
_PIECE_NS = 4 * _NS
# A report belongs to an exchange if both agree within this, because stamps are whole ns [ns].
_SAME_NS = 2_000
# Within this time two clocks drift apart by less than the error of their stamps [ns].
_STEP_NS = _NS // 1000
# An answer may seem to precede its question by this much, because of the error of the stamps [ns].
_EARLY_NS = 1_000_000
# Largest plausible difference of two clocks [s]: some 300 years.
_LONGEST_S = 1e10
# Weight of the time by which a stamp lies outside of a run, against the time for which its message was under way.
_OUTSIDE = 10.0
# Represents an unknown delay [ns]; a delay of so much either way, some 36 years, is of a stamp that no clock had.
_LONG_NS = 2**60


class SiteClock(NamedTuple):
    """Lead of the slave's clock over the master's, in one run or more, between which one of the clocks was set.

    applied: whether it is subtracted from the slave's stamps, and the reason as text; drift: mean drift [s/s]; span_ns:
    first and last time of the recording [ns].
    """

    runs: tuple[Run, ...]
    drift: float
    applied: bool
    reason: str
    span_ns: tuple[int, int]

    @property
    def offset_s(self) -> float | None:
        """Lead in the middle of the recording [s]; None if a clock was set, because there is no single lead."""
        if len(self.runs) > 1:
            return None
        run = self.runs[0]
        return _lead_ns(run, (run.first_ns + run.last_ns) // 2) / _NS

    @property
    def uncertainty_s(self) -> float:
        """Bound of the error of the lead in the run in which it is greatest [s]."""
        return max(run.error_ns for run in self.runs) / _NS

    @property
    def greatest_s(self) -> float:
        """Greatest lead or lag in any run [s]."""
        return max(abs(ahead_ns) for run in self.runs for _, ahead_ns in run.knots) / _NS

    def ahead_ns(self, stamps_ns: Ints, heard_ns: Ints | None = None) -> Ints:
        """Return the lead of the slave's clock at its own times [ns], shape (n,), whether it is applied or not.

        Args:
            stamps_ns: Times by the slave's clock [ns], shape (n,).
            heard_ns: Times of reception by the master's clock [ns], shape (n,). Without them a time that a clock which
                was set back has twice belongs to the earlier run.
        """
        leads = [_ahead_ns(run, stamps_ns) for run in self.runs]
        if len(leads) == 1:
            return leads[0]
        # A run lasts until the middle of the pause in which the clock was set.
        middles = [(run.last_ns + after.first_ns) // 2 for run, after in pairwise(self.runs)]
        ends = [min(self.span_ns[0], self.runs[0].first_ns), *middles, max(self.span_ns[1], self.runs[-1].last_ns)]
        costs = []
        for place, ahead_ns in enumerate(leads):
            times_ns = (stamps_ns - ahead_ns).astype(np.float64)
            begin_ns, end_ns = ends[place], ends[place + 1]
            outside_ns = np.maximum(begin_ns - times_ns, 0.0) + np.maximum(times_ns - end_ns, 0.0)
            costs.append(_OUTSIDE * outside_ns + (0.0 if heard_ns is None else np.abs(heard_ns - times_ns)))
        return np.asarray(np.choose(np.argmin(costs, axis=0), leads), np.int64)

    def of_part(self, first_ns: int, last_ns: int) -> "SiteClock":
        """Return the clock of one file of the slave's recorder, by its first and last time: with one run alone.

        A recorder that begins again with its site begins another file.
        """

        def outside_ns(run: Run) -> int:
            times_ns = (first_ns - _lead_ns(run, run.first_ns), last_ns - _lead_ns(run, run.last_ns))
            return round(max(run.first_ns - times_ns[0], 0.0) + max(times_ns[1] - run.last_ns, 0.0))

        return self._replace(runs=(min(self.runs, key=outside_ns),))

    def stamp_ns(self, time_ns: int) -> int:
        """Return the time by the slave's clock at a time by the master's [ns]."""
        behind = (
            place
            for place, (run, after) in enumerate(pairwise(self.runs))
            if time_ns < (run.last_ns + after.first_ns) // 2
        )
        run = self.runs[next(behind, len(self.runs) - 1)]
        return time_ns + round(_lead_ns(run, time_ns))


def _ahead_ns(run: Run, stamps_ns: Ints) -> Ints:
    """Return the lead at times of the slave's clock [ns], shape (n,); first and last line go on beyond the ends."""
    knots_ns = [at_ns + round(ahead_ns) for at_ns, ahead_ns in run.knots]
    x = np.array([knot - knots_ns[0] for knot in knots_ns], dtype=np.float64)
    at = (stamps_ns - knots_ns[0]).astype(np.float64)
    part = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    ahead, widths = np.array([ahead_ns for _, ahead_ns in run.knots]), np.maximum(np.diff(x), 1.0)
    return np.asarray(np.rint(ahead[part] + np.diff(ahead)[part] / widths[part] * (at - x[part])), np.int64)


def _lead_ns(run: Run, time_ns: int) -> float:
    """Return the lead at a time of the master's clock [ns]."""
    later = (place for place, (at_ns, _) in enumerate(run.knots) if at_ns > time_ns)
    place = min(max(next(later, len(run.knots) - 1), 1), len(run.knots) - 1)
    (before_ns, before), (after_ns, after) = run.knots[place - 1], run.knots[place]
    return before + (after - before) / max(1, after_ns - before_ns) * (time_ns - before_ns)


class ClockShift:
    """Function that returns the shift to add to a stamp of the slave's site [ns]; 0 without a correction.

    It serves rising stamps one by one and reuses the shift within `_STEP_NS`.
    """

    def __init__(self, clock: SiteClock | None) -> None:
        self._clock = clock if clock is not None and clock.applied else None
        self._first_ns, self._heard_ns, self._shift_ns = -_STEP_NS, 0, 0

    @property
    def is_needed(self) -> bool:
        """Whether the clocks differ, so that stamps are corrected."""
        return self._clock is not None

    def __call__(self, stamp_ns: int, heard_ns: int) -> int:
        """Return the shift of a stamp [ns] of a message that was received at a time of the master's clock [ns]."""
        is_near = 0 <= stamp_ns - self._first_ns < _STEP_NS and abs(heard_ns - self._heard_ns) < _NS
        if self._clock is not None and not is_near:
            self._first_ns, self._heard_ns = stamp_ns - stamp_ns % _STEP_NS, heard_ns
            stamps, heard = (np.array([at_ns], dtype=np.int64) for at_ns in (self._first_ns, heard_ns))
            self._shift_ns = -int(self._clock.ahead_ns(stamps, heard)[0])
        return self._shift_ns


class Timeline:
    """Conversion of the stamps of all sources of a recording to the master's clock [ns].

    A source that was replayed beside live ones is shifted to the time of its replay, see `replay_shifts`.
    """

    def __init__(self, recording: RecordingSource, *, quick: bool = False) -> None:
        """Estimate the clocks; `quick` reads only the last report of each node to detect a replay."""
        self.shifts = replay_shifts(recording, newest=quick)
        self.clock = read_site_clock(recording)
        self._is_masters = _is_masters(recording)

    def with_clock(self, clock: SiteClock | None) -> "Timeline":
        """Return a copy with another clock of the slave's site."""
        other = Timeline.__new__(Timeline)
        other.shifts, other.clock, other._is_masters = self.shifts, clock, self._is_masters
        return other

    def times_ns(
        self, src: str, stamps_ns: npt.NDArray[Any], heard_ns: npt.NDArray[Any] | None = None
    ) -> npt.NDArray[Any]:
        """Return the stamps of a source converted to the master's clock [ns], shape (n,).

        Args:
            src: The node that made the stamps.
            stamps_ns: The stamps [ns], shape (n,).
            heard_ns: Times at which this recording's recorder received them [ns], shape (n,): they say which run of a
                clock that was set back a stamp belongs to.
        """
        if src in self.shifts:
            return stamps_ns + self.shifts[src]
        if self._differs(src) and self.clock is not None and stamps_ns.size:
            heard = None if heard_ns is None or not self._is_masters else heard_ns.astype(np.int64)
            return stamps_ns - self.clock.ahead_ns(stamps_ns.astype(np.int64), heard)
        return stamps_ns

    def time_ns(self, message: RecordedMessage) -> int:
        """Return the stamp of a message on the master's clock [ns]."""
        stamp, heard = (np.array([at_ns], dtype=np.int64) for at_ns in (message.publish_ns, message.log_ns))
        return int(self.times_ns(message.src, stamp, heard)[0])

    def stamp_ns(self, src: str, time_ns: int) -> int:
        """Return the stamp of a source at a time of the master's clock [ns]: the inverse of `times_ns`."""
        if src in self.shifts:
            return time_ns - self.shifts[src]
        if self._differs(src) and self.clock is not None:
            return self.clock.stamp_ns(time_ns)
        return time_ns

    def _differs(self, src: str) -> bool:
        return self.clock is not None and self.clock.applied and is_of_slave(src)


def is_of_slave(src: str) -> bool:
    """Return whether a node stamps its messages by the clock of the slave's site."""
    # The link's endpoint at the slave's site belongs to a process at the master's.
    return site_of(src) == "slave" and name_of(src) != LINK


def _is_masters(recording: RecordingSource) -> bool:
    """Return whether the reception times are by the master's clock."""
    return site_of(recording.metadata.get("recording", {}).get("node", "")) == "master"


def read_site_clock(recording: RecordingSource) -> SiteClock | None:
    """Return the estimate of the slave's clock from the link's measurements; None if there are none."""
    on_clocks = _ClockMessages(recording, _windows(*recording.span_ns))
    judged = (_judged(on_clocks, topic) for topic in (_STATUS, _NETWORK))
    return next((clock for clock in judged if clock is not None), None)


def _windows(first_ns: int, last_ns: int) -> list[tuple[int, int]]:
    """Return the windows of a recording that are read [ns]; a single one of the whole if it is short."""
    length_ns = last_ns - first_ns
    if length_ns <= _WHOLE_NS:
        return [(first_ns, last_ns + 1)]
    count = min(_MOST_WINDOWS, max(_FEWEST_WINDOWS, 1 + math.ceil(length_ns / _STEP_OF_WINDOWS_NS)))
    step_ns = (length_ns - _WINDOW_NS) // (count - 1)
    return [(first_ns + n * step_ns, first_ns + n * step_ns + _WINDOW_NS) for n in range(count)]


class _ClockMessages:
    """Messages about clocks in the windows of a recording, read once; other parts are read on request."""

    def __init__(self, recording: RecordingSource, windows: list[tuple[int, int]]) -> None:
        self.windows, self._recording = windows, recording
        self.is_masters, self.span_ns = _is_masters(recording), recording.span_ns
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
        """Return the messages of the wanted channels from `first_ns` up to `last_ns` (excluded) [ns].

        Outside of the windows only `_MOST_SOUGHT` calls are answered; later ones return nothing.
        """
        if any(first <= first_ns and last_ns <= last for first, last in self.windows):
            bounds = (bisect_left(self._messages, at_ns, key=_received_ns) for at_ns in (first_ns, last_ns))
            return [message for message in self._messages[slice(*bounds)] if wanted(message.channel)]
        self._more -= 1
        return self._recording.select(wanted, first_ns, last_ns) if self._more >= 0 else ()


class _Report(NamedTuple):
    """Content of a clock report; answer: send and reception time of the newest answer [ns], None if unknown."""

    t_ns: int
    offset_s: float
    uncertainty_s: float
    answer: tuple[int, int] | None


def _reports(on_clocks: _ClockMessages, topic: str, window: tuple[int, int]) -> Iterator[_Report]:
    """Yield the valid reports of a window that the link's end at the master made."""
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


def _bounds(on_clocks: _ClockMessages, topic: str, window: tuple[int, int]) -> Bounds | None:
    """Return the clock bounds in a window: upper ones from questions, or else from reports; lower ones from reports."""
    reports = list(_reports(on_clocks, topic, window))
    upper = _questions(on_clocks, window)
    if not upper:
        # Each report states the bounds at its own time.
        upper = [(report.t_ns, round((report.offset_s + report.uncertainty_s) * _NS)) for report in reports]
    lower = [(r.answer[1], r.answer[0] - r.answer[1]) for r in reports if r.answer is not None]
    lower = lower or _reported_lower_bounds(reports, upper)
    return Bounds(upper, lower) if upper and lower else None


def _reported_lower_bounds(reports: list[_Report], upper: list[Bound]) -> list[Bound]:
    """Return the lower bounds of reports without the times of an answer, such as those of the datagram link.

    Each is dated to the earlier exchange whose upper bound equals the report's, or else to the report itself.
    """
    asked = {round(ahead_ns / _SAME_NS): asked_ns for asked_ns, ahead_ns in upper}
    bounds = []
    for report in reports:
        place = round((report.offset_s + report.uncertainty_s) * _NS / _SAME_NS)
        made = (asked[near] for near in (place, place - 1, place + 1) if near in asked)
        bounds.append((next(made, report.t_ns), round((report.offset_s - report.uncertainty_s) * _NS)))
    return bounds


def _questions(on_clocks: _ClockMessages, window: tuple[int, int]) -> list[tuple[int, int]]:
    """Return for each question its send time by the master's clock and its delay as the two clocks show it [ns]."""
    questions = []
    answers = on_clocks.select(lambda c: c.topic == _ANSWER and is_of_slave(c.src), *window)
    for _, fields in readable(answers, LeftOut()):
        questions.append((fields["ping_t_ns"], fields["received_ns"] - fields["ping_t_ns"]))
    return questions


def _judged(on_clocks: _ClockMessages, topic: str) -> SiteClock | None:
    pieces = _pieces(on_clocks, topic)
    if not pieces:
        return None
    found = runs(pieces, lambda first_ns, last_ns: _bounds(on_clocks, topic, (first_ns, last_ns)))
    drift = mean_drift(found)
    clock = SiteClock(tuple(found), drift, applied=False, reason="", span_ns=on_clocks.span_ns)
    is_beyond = clock.greatest_s > clock.uncertainty_s
    early_s, early_without_s = _earliest_s(on_clocks, clock)
    limit_s = _EARLY_NS / _NS
    if set_back_s := _set_back_s(on_clocks, topic):
        return clock._replace(reason=f"the clock of the recording was set back by {set_back_s:.4g} s within it")
    if early_s < -limit_s <= early_without_s:
        words = f"{_in_words(clock)} was measured, but then an answer would come {-early_s:.3g} s too early"
        return clock._replace(reason=words)
    if is_beyond:
        words = f"the slave's clock is {_in_words(clock)}, which is known to {clock.uncertainty_s:.2g} s"
    elif early_without_s < -limit_s:
        words = f"by the stamps as they are an answer came {-early_without_s:.3g} s before its question"
    elif drift != 0.0:
        words = f"the clocks drift apart by {1e6 * drift:.3g} ppm"
    else:
        words = f"{_in_words(clock)} is within the {clock.uncertainty_s:.2g} s that half the round trip leaves open"
        return clock._replace(reason=words)
    return clock._replace(applied=True, reason=words)


def _set_back_s(on_clocks: _ClockMessages, topic: str) -> float:
    """Return the largest backward step of the master's clock [s]: a later report has an earlier stamp; 0 if none.

    If a sequence number occurs twice the node was restarted, and the result is 0.
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
    """Return the bounds of all windows, in parts of at most `_PIECE_NS` within which no clock was set."""
    pieces = []
    for window in on_clocks.windows:
        bounds = _bounds(on_clocks, topic, window)
        # Bounds that contradict each other throughout are kept: what follows from them is refused in words.
        for part in (split(bounds) or [bounds]) if bounds is not None else ():
            by_piece: dict[int, tuple[list[Bound], list[Bound]]] = {}
            for side, bounds_of_side in enumerate(part):
                for bound in bounds_of_side:
                    by_piece.setdefault(bound[0] // _PIECE_NS, ([], []))[side].append(bound)
            found = (bounds_of(*by_piece[number]) for number in sorted(by_piece))
            pieces += [piece for piece in found if piece is not None]
    return pieces


def _in_words(clock: SiteClock) -> str:
    """Return the leads, with the times from which they hold [s], such as `3 s ahead, and 27 s behind from 3.1 s on`."""
    leads: list[str] = []
    for run in clock.runs:
        ahead_s = _lead_ns(run, (run.first_ns + run.last_ns) // 2) / _NS
        since = f" from {(run.first_ns - clock.span_ns[0]) / _NS:.1f} s on" if leads else ""
        # Digits beyond the error would be none, but leads that differ must read differently.
        digits = max(0, 1 - math.floor(math.log10(max(run.error_ns, 1.0) / _NS)))
        lead = f"{abs(ahead_s):.{digits}f} s {'ahead' if ahead_s >= 0.0 else 'behind'}"
        if len(clock.runs) > 1 and abs(ahead_s) * _NS < run.error_ns:
            lead = f"less than {run.error_ns / _NS:.2g} s off"
        leads.append(lead + since)
    return leads[0] if len(leads) == 1 else f"{', '.join(leads[:-1])}, and {leads[-1]}, because a clock was set"


def _earliest_s(on_clocks: _ClockMessages, clock: SiteClock) -> tuple[float, float]:
    """Return the least delay across the link [s], with the clock correction and without it; negative breaks causality.

    The delay there is from a sample of the hand to the state of the tip that obeys it. The delay back is from the stamp
    of that state to its reception; it is known only if the recorder is at the master's site.
    """
    stamps, heard, there, back = [], [], [], []
    for window in on_clocks.examined:
        for message in on_clocks.select(_is_tip, *window):
            hand_ns = _hand_ns(message)
            stamps.append(message.publish_ns)
            heard.append(message.log_ns)
            there.append(_known_ns(message.publish_ns - hand_ns) if hand_ns else _LONG_NS)
            back.append(_known_ns(message.log_ns - message.publish_ns) if on_clocks.is_masters else _LONG_NS)
    if not stamps:
        return math.inf, math.inf
    received_ns = np.array(heard, dtype=np.int64) if on_clocks.is_masters else None
    ahead_ns = clock.ahead_ns(np.array(stamps, dtype=np.int64), received_ns)
    ways = np.array(there, dtype=np.int64), np.array(back, dtype=np.int64)
    shifted = min(int((ways[0] - ahead_ns).min()), int((ways[1] + ahead_ns).min()))
    return shifted / _NS, min(int(ways[0].min()), int(ways[1].min())) / _NS


def _known_ns(delay_ns: int) -> int:
    return delay_ns if abs(delay_ns) < _LONG_NS else _LONG_NS


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

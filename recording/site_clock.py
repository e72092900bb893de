"""The clock of the slave's site against the master's over a recording, and all stamps of a recording on one clock.

Two machines have two clocks. Their difference is in the recording: `link/status` has ten times a second the best of the
last exchanges of four time stamps, with a bound of its error. That bound is half the round trip, because no exchange
can tell a difference of the clocks from ways that differ there and back. So the difference is taken off only where the
clocks are shown to differ: it is beyond its bound, they drift apart, or without it an answer would come before its
question. One machine, or a link of 10 ms there and 70 ms back, shows none of these.

The drift is that of the questions of these exchanges (`clock/pong`). By two clocks a question takes its way plus what
the other clock is ahead, and no queue makes that less: a line through the lower envelope rises with the drift. It
counts where the way back falls as much as the way there rises, which a queue that fills does not do.
"""

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from proto.errors import RecordingError
from proto.nodes import site_of
from recording.arrays import replay_shifts
from recording.messages import RecordedChannel, RecordedMessage
from recording.multi_file import RecordingSource

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

_NS = 1_000_000_000
_STATUS, _NETWORK, _ANSWER = "link/status", "link/network", "clock/pong"
# a recording of more than a minute is looked at in eight windows of ten seconds, each longer than an exchange is kept
_WINDOW_NS, _MOST_WINDOWS = 10 * _NS, 8
# The tip's samples of so long a time are examined in each window.
_CAUSALITY_NS = 2 * _NS
# The fastest question of each block counts; ten are asked in a second.
_BLOCK_NS = _NS
# Each minute has a straight line of its own, because temperature and time services change the rate of a clock slowly.
_SEGMENT_S = 60.0
# A line needs at least so many blocks.
_SEGMENT_BLOCKS = 8
# a growth that is so many times the scatter about its line, and so large [ns], is no chance; over so many blocks
_SURE_GROWTH, _LEAST_GROWTH_NS, _LEAST_BLOCKS = 10.0, 500_000, 5
# The drift of the other way may differ by this share.
_UNLIKE = 0.3
# No clock of a computer drifts by more than this.
_MOST_DRIFT = 2e-3
# An exchange is recognised by its way there [s], because stamps are whole ns.
_SAME_S = 2e-6
# Two clocks drift apart in this time by less than the error of their stamps.
_STEP_NS = _NS // 1000
# An answer may precede its question by so much, because of the error of the stamps [ns].
_EARLY_NS = 1_000_000
# This stands for a delay of which nothing is known [ns].
_LONG_NS = 2**60


class SiteClock(NamedTuple):
    """What the slave's clock is ahead of the master's.

    offset_s: in the middle of the recording [s]; uncertainty_s: bound of its error [s]; drift: what it gains [s/s];
    applied: whether it is taken off the slave's stamps, and the reason. knots_ns: times by the slave's clock [ns], with
    ahead_s there [s]; a straight line between two.
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
        part = np.clip(np.searchsorted(x, at) - 1, 0, len(x) - 2)
        ahead, slopes = np.array(self.ahead_s), np.diff(self.ahead_s) / np.diff(x)
        # Beyond the ends the first and the last line are extended.
        return np.asarray(np.rint((ahead[part] + slopes[part] * (at - x[part])) * _NS), dtype=np.int64)

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

    def __init__(self, recording: RecordingSource) -> None:
        self.shifts = replay_shifts(recording)
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
    return bool(src) and site_of(src) == "slave"


def read_site_clock(recording: RecordingSource) -> SiteClock | None:
    """Return the slave's clock as the link measured it; None where it was not measured."""
    windows = _windows(*recording.span_ns)
    for topic in (_STATUS, _NETWORK):
        reports = [report for window in windows for report in _reports(recording, topic, window)]
        if reports:
            return _judged(recording, windows, reports)
    return None


def _windows(first_ns: int, last_ns: int) -> list[tuple[int, int]]:
    """Return the parts of a recording that are looked at [ns]: all of a short one."""
    length_ns = last_ns - first_ns
    count = min(_MOST_WINDOWS, math.ceil(length_ns / _WINDOW_NS / 6))
    if count <= 1:
        return [(first_ns, last_ns + 1)]
    step_ns = (length_ns - _WINDOW_NS) // (count - 1)
    return [(first_ns + n * step_ns, first_ns + n * step_ns + _WINDOW_NS) for n in range(count)]


class _Report(NamedTuple):
    t_ns: int
    offset_s: float
    uncertainty_s: float


def _reports(recording: RecordingSource, topic: str, window: tuple[int, int]) -> Iterator[_Report]:
    """Yield the valid reports of a window, those that the master's end made."""
    for message in recording.select(lambda channel: channel.topic == topic and channel.via == "direct", *window):
        try:
            fields = message.fields()
        except RecordingError:
            continue
        clock = fields.get("clock")
        if topic == _NETWORK and fields.get("direction") != "backward":
            continue
        if not isinstance(clock, dict) or clock.get("valid") is not True:
            continue
        offset_s, uncertainty_s = clock.get("offset_s"), clock.get("uncertainty_s")
        if isinstance(offset_s, float) and isinstance(uncertainty_s, float):
            yield _Report(message.publish_ns, offset_s, uncertainty_s)


class _Questions(NamedTuple):
    """Questions of the link to the other site, shape (n,) each.

    asked_ns: by the master's clock [ns]; there_ns, back_ns: how long question and answer took by two clocks [ns], the
    latter to the recorder, and empty where that is not at the master's site.
    """

    asked_ns: Ints
    there_ns: Ints
    back_ns: Ints


def _questions(recording: RecordingSource, windows: list[tuple[int, int]]) -> _Questions:
    rows = []
    for window in windows:
        for message in recording.select(lambda c: c.topic == _ANSWER and is_of_slave(c.src), *window):
            try:
                fields = message.fields()
                asked_ns, received_ns = int(fields["ping_t_ns"]), int(fields["received_ns"])
            except (RecordingError, KeyError, TypeError, ValueError):
                continue
            rows.append((asked_ns, received_ns - asked_ns, message.log_ns - message.publish_ns))
    rows.sort()
    found = np.array(rows, dtype=np.int64).reshape(-1, 3)
    return _Questions(found[:, 0], found[:, 1], found[:, 2] if _is_masters(recording) else found[:0, 2])


def _judged(recording: RecordingSource, windows: list[tuple[int, int]], reports: list[_Report]) -> SiteClock:
    best = min(reports, key=lambda report: report.uncertainty_s)
    questions = _questions(recording, windows)
    origin_ns = reports[0].t_ns
    middle_ns = (reports[-1].t_ns - origin_ns) // 2
    knots, ahead, drift = _course(questions, best, origin_ns)
    clock = SiteClock(
        offset_s=0.0,
        uncertainty_s=best.uncertainty_s,
        drift=drift,
        applied=False,
        reason="",
        knots_ns=tuple(origin_ns + round(at + off) for at, off in zip(knots.tolist(), ahead.tolist(), strict=True)),
        ahead_s=tuple((ahead / _NS).tolist()),
    )
    clock = clock._replace(offset_s=clock.one_ahead_ns(origin_ns + middle_ns + round(best.offset_s * _NS)) / _NS)
    beyond = next((report for report in reports if abs(report.offset_s) > report.uncertainty_s), None)
    early_s, early_without_s = _earliest_s(recording, windows, clock)
    limit_s = _EARLY_NS / _NS
    if early_s < -limit_s <= early_without_s:
        words = f"{_spoken(clock.offset_s)} was measured, but then an answer would come {-early_s:.3g} s too early"
        return clock._replace(reason=words)
    if beyond is not None:
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


def _course(questions: _Questions, best: _Report, origin_ns: int) -> tuple[Floats, Floats, float]:
    """Return times since an origin [ns], what the slave's clock is ahead there [ns], and its drift; 0 if none is sure.

    The lower envelope of the way there has the course, and the best exchange what the way itself takes of it.
    """
    flat = np.array([0.0]), np.array([best.offset_s * _NS]), 0.0
    times, there = _envelope(questions.asked_ns - origin_ns, questions.there_ns)
    _, back = _envelope(questions.asked_ns[: len(questions.back_ns)] - origin_ns, questions.back_ns)
    if len(times) < _LEAST_BLOCKS or len(back) != len(times):
        return flat
    ends = times[[0, -1]]
    lines = [_through(times, values, ends) for values in (there, back)]
    growths = [float(line[1] - line[0]) for line in lines]
    scatter = float(np.sqrt(np.mean((there - np.interp(times, ends, lines[0])) ** 2)))
    drift = growths[0] / float(ends[1] - ends[0])
    is_sure = abs(growths[0]) > max(_SURE_GROWTH * scatter, _LEAST_GROWTH_NS) and abs(drift) <= _MOST_DRIFT
    if not is_sure or abs(growths[0] + growths[1]) > _UNLIKE * abs(growths[0]):
        return flat
    parts = max(1, min(int((ends[1] - ends[0]) * 1e-9 // _SEGMENT_S), len(times) // _SEGMENT_BLOCKS))
    knots = np.unique(np.quantile(times, np.linspace(0.0, 1.0, parts + 1)))
    course = _through(times, there, knots)
    # The best report rests on this exchange, which may have been made seconds before.
    off = np.abs(questions.there_ns * 1e-9 - (best.offset_s + best.uncertainty_s))
    place = int(np.argmin(off))
    made = float((questions.asked_ns[place] if off[place] < _SAME_S else best.t_ns) - origin_ns)
    return knots, course - (float(np.interp(made, knots, course)) - best.offset_s * _NS), drift


def _envelope(asked_ns: Ints, way_ns: Ints) -> tuple[Floats, Floats]:
    """Return the fastest way of each block of a second, and when it was gone [ns]."""
    if not asked_ns.size:
        return np.empty(0), np.empty(0)
    begins = np.flatnonzero(np.diff(asked_ns // _BLOCK_NS, prepend=-1) != 0)
    parts = np.split(np.arange(asked_ns.size), begins[1:] if begins[0] == 0 else begins)
    least = np.array([part[int(np.argmin(way_ns[part]))] for part in parts])
    return asked_ns[least].astype(np.float64), way_ns[least].astype(np.float64)


def _spoken(offset_s: float) -> str:
    return f"{abs(offset_s):.4g} s {'ahead' if offset_s >= 0.0 else 'behind'}"


def _through(times: Floats, values: Floats, knots: Floats) -> Floats:
    """Return the values at knots of the broken line that is nearest to points, which lie in each of its parts.

    A point depends on the two knots beside it, so the normal equations of least squares are tridiagonal. They are
    solved by elimination in order: the digits of LAPACK would depend on the processor.
    """
    last = len(knots) - 1
    left = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, last - 1)
    share = (times - knots[left]) / (knots[left + 1] - knots[left])
    middle = float(np.median(values))

    def summed(at_left: Floats, at_right: Floats) -> list[float]:
        # `bincount` adds in the order of the points, so the sums have the same bits on every processor.
        sums = np.bincount(left, at_left, last + 1) + np.bincount(left + 1, at_right, last + 1)
        return [float(value) for value in sums]

    rest = 1.0 - share
    diagonal, wanted = summed(rest * rest, share * share), summed(rest * (values - middle), share * (values - middle))
    beside = [float(value) for value in np.bincount(left, rest * share, last)]
    for i in range(last):
        factor = beside[i] / diagonal[i]
        diagonal[i + 1] -= factor * beside[i]
        wanted[i + 1] -= factor * wanted[i]
    found = [wanted[last] / diagonal[last]]
    for i in reversed(range(last)):
        found.append((wanted[i] - beside[i] * found[-1]) / diagonal[i])
    return np.array(found[::-1]) + middle


def _earliest_s(recording: RecordingSource, windows: list[tuple[int, int]], clock: SiteClock) -> tuple[float, float]:
    """Return by how much the earliest of what crossed the link came after it was sent [s], with the offset and without.

    Below zero it came before. There: from a sample of the hand to the state of the tip that obeys it; back: from the
    stamp of that state to its reception, where the recorder is at the master's site.
    """
    received_here = _is_masters(recording)
    stamps, there, back = [], [], []
    for first_ns, last_ns in windows:
        until_ns = min(last_ns, first_ns + _CAUSALITY_NS)
        for message in recording.select(_is_tip, first_ns, until_ns):
            hand_ns = _hand_ns(message)
            stamps.append(message.publish_ns)
            there.append(message.publish_ns - hand_ns if hand_ns else _LONG_NS)
            back.append(message.log_ns - message.publish_ns if received_here else _LONG_NS)
    if not stamps:
        return math.inf, math.inf
    ahead_ns = clock.ahead_ns(np.array(stamps, dtype=np.int64))
    ways = np.array(there, dtype=np.int64), np.array(back, dtype=np.int64)
    shifted = min(int((ways[0] - ahead_ns).min()), int((ways[1] + ahead_ns).min()))
    return shifted / _NS, min(int(ways[0].min()), int(ways[1].min())) / _NS


def _is_masters(recording: RecordingSource) -> bool:
    """Return whether times of reception are those of the master's clock."""
    return site_of(recording.metadata.get("recording", {}).get("node", "")) == "master"


def _is_tip(channel: RecordedChannel) -> bool:
    return channel.topic == "afm/state" and channel.via == "direct" and is_of_slave(channel.src)


def _hand_ns(message: RecordedMessage) -> int:
    try:
        found = message.fields().get("hand_t_ns", 0)
    except RecordingError:
        return 0
    return found if isinstance(found, int) else 0

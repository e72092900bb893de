"""Measure the capacity of a line by the rate at which datagrams leave a queue that this direction has filled itself.

While a queue stands, datagrams arrive at the rate of the line, however fast they are sent. The measurement therefore
needs two consecutive intervals in which the delay changed at clearly different rates, because more was sent in one than
in the other, while the same rate arrived in both. A route that becomes longer or shorter looks different: while the
delay grows, less arrives than is sent, and while it falls, more does, in the same proportion. Other traffic looks
different too: its share of the line changes. The rate is measured by the receiver's clock, and delays are only compared
with one another, so that the offset of the clocks does not matter.
"""

import itertools
from collections import deque
from typing import NamedTuple

# The share of the line that the rig's TCP traffic takes, which no measurement contains [bit/s].
BESIDE_BIT_PER_S = 100_000
# Datagrams within this time are one point of the delay's course [ns].
_STEP_NS = 20_000_000
# The length of the course that is kept [ns].
_KEPT_NS = 3_000_000_000
# An interval lasts at least this time [ns] and has at least this number of datagrams.
_LEAST_NS = 120_000_000
_FEWEST = 12
# While a queue stands, the delay is above the least of the course by at least this [ns].
_STANDS_NS = 4_000_000
# The slopes of the delay in the two intervals differ by at least this.
_APART = 0.12
# The delay must change by at least this multiple of the median difference of neighbouring points.
_BEYOND = 8
# The arrival rates of the two intervals agree within this share of the difference that a route would make, and within
# the counting error.
_SAME = 0.3


class Point(NamedTuple):
    """The newest datagram of a step: time of arrival, delay by two clocks [ns], and bytes and datagrams up to it."""

    at_ns: int
    delay_ns: int
    size_bytes: int
    datagrams: int


class Measured(NamedTuple):
    """The capacity of a line and its interval [bit/s]; an upper end of None is open."""

    bit_per_s: int
    low_bit_per_s: int
    high_bit_per_s: int | None


class FullQueue:
    """The course of the delay of a direction, and the capacity that a full queue shows."""

    def __init__(self) -> None:
        self._points: deque[Point] = deque()
        self._bytes = self._count = 0

    def forget(self) -> None:
        """Forget the course, because the next datagrams are of another line or another process."""
        self._points.clear()

    def record(self, size_bytes: int, delay_ns: int, now_ns: int) -> Measured | None:
        """Record a datagram; return the capacity of the line, None while it is unknown.

        Args:
            size_bytes: Its size with headers [bytes].
            delay_ns: Its delay by two clocks [ns].
            now_ns: Its time of arrival [ns].
        """
        self._bytes += size_bytes
        self._count += 1
        points = self._points
        if points and now_ns < points[-1].at_ns:
            points.clear()
        if points and now_ns - points[-1].at_ns < _STEP_NS:
            return None
        points.append(Point(now_ns, delay_ns, self._bytes, self._count))
        while now_ns - points[0].at_ns > _KEPT_NS:
            points.popleft()
        return self._measured()

    def _measured(self) -> Measured | None:
        """Return the rate of the newest two intervals that show it."""
        points = list(self._points)
        floor_ns = min(point.delay_ns for point in points) + _STANDS_NS
        end = len(points) - 1
        begin = end
        while begin and points[begin - 1].delay_ns >= floor_ns:
            begin -= 1
        if points[end].delay_ns < floor_ns or points[end].at_ns - points[begin].at_ns < 2 * _LEAST_NS:
            return None
        # The intervals meet where the delay is greatest or least, or in the middle.
        inside = points[begin : end + 1]
        apart = sorted(abs(after.delay_ns - before.delay_ns) for before, after in itertools.pairwise(inside))
        varied_ns = _BEYOND * apart[len(apart) // 2]
        for turn in {
            max(range(len(inside)), key=lambda place: inside[place].delay_ns),
            min(range(len(inside)), key=lambda place: inside[place].delay_ns),
            len(inside) // 2,
        }:
            if (rate := _common(inside[0], inside[turn], inside[-1], varied_ns)) is not None:
                return rate
        return None


def _common(first: Point, turn: Point, last: Point, varied_ns: int) -> Measured | None:
    """Return the common rate of two intervals; None if they are too short, too alike in slope, or differ in rate."""
    parts = ((first, turn), (turn, last))
    if any(end.at_ns - begin.at_ns < _LEAST_NS or end.datagrams - begin.datagrams < _FEWEST for begin, end in parts):
        return None
    slopes = [(end.delay_ns - begin.delay_ns) / (end.at_ns - begin.at_ns) for begin, end in parts]
    rates = [(end.size_bytes - begin.size_bytes) / (end.at_ns - begin.at_ns) for begin, end in parts]
    apart = abs(slopes[0] - slopes[1])
    changed_ns = sum(abs(end.delay_ns - begin.delay_ns) for begin, end in parts)
    if apart < _APART or not all(rates) or changed_ns < varied_ns:
        return None
    counted = sum(1.0 / (end.datagrams - begin.datagrams) for begin, end in parts)
    if abs(rates[0] / rates[1] - 1.0) > max(_SAME * apart, min(counted, 0.5 * apart)):
        return None
    whole = (last.size_bytes - first.size_bytes) / (last.at_ns - first.at_ns)
    # Each interval shows the rate by itself, to within a datagram at each of its ends.
    off = counted + max(abs(rate / whole - 1.0) for rate in rates)
    rate, low, high = (round(8e9 * whole * share) for share in (1.0, max(0.0, 1.0 - off), 1.0 + off))
    return Measured(rate, low, high + BESIDE_BIT_PER_S)

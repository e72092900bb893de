"""The straight line of what another clock is ahead, from the fastest messages of both ways.

It is the one estimate of clocks: of the last seconds on a link (`telenano.timing.clock_offset`), of a line whose
queues are sought before a line between two machines, and of the parts of a recording
(`telenano.recording.clock_course`).

A message sent at t1 by this clock and received at t2 by the other one took t2 - t1 by two clocks, its way plus what the
other clock is ahead there: the clock is ahead by no more than that. An answer sent at t3 and received at t4 says that
it is ahead by no less than t3 - t4. No queue makes a way shorter. So what the other clock is ahead lies below all of
the former and above all of the latter, and two parallel lines that touch both from inside, as far apart as they can be,
have its drift as their slope (the convex hull method). The middle between them is the estimate, and half of their
distance, which is half of the shortest round trip, bounds its error: no exchange tells a clock from ways that differ.
"""

import itertools
import math
import operator
from collections.abc import Iterable, Sequence
from typing import NamedTuple

# A time by this clock [ns], and a bound at that time of what the other one is ahead [ns].
Bound = tuple[int, int]

# No clock of a computer gains more than this in a second [s].
MOST_DRIFT = 2e-3
# A drift that brings the lines apart by no more than this [ns] is not shown.
LEAST_GAIN_NS = 500_000.0
# Of the clocks of a session, chance has no greater share that are said to have changed and have not.
_BY_CHANCE = 0.01
# Bounds that scatter by less are as exact as stamps are, and what is left of them is rounding [ns].
_EXACT_NS = 1_000.0
# Of this number of points on each side, chance brings the lines apart by about what the points scatter; of more that do
# not follow from their neighbours, by less.
_FEW = 8


class ClockLine(NamedTuple):
    """What the other clock is ahead: ahead_ns [ns] at origin_ns by this clock [ns], growing by drift [s/s].

    round_trip_ns: distance of the two lines [ns], below zero where no line lies between the bounds; chance_ns: how far
    chance may bring lines apart through this number of points with their scatter [ns].
    """

    origin_ns: int
    ahead_ns: float
    drift: float
    round_trip_ns: float
    chance_ns: float

    def at(self, time_ns: int) -> float:
        """Return what the other clock is ahead at a time by this one [ns]."""
        return self.ahead_ns + self.drift * (time_ns - self.origin_ns)

    @classmethod
    def through(
        cls,
        upper: Sequence[Bound],
        lower: Sequence[Bound],
        expected_drift: float = 0.0,
        most_ns: float = math.inf,
    ) -> "ClockLine":
        """Return the line between bounds from above and from below, neither of them empty.

        The best of each second are enough points. A drift other than the expected one has to bring the lines apart by
        more than chance does; a queue that fills on one way does not.

        Args:
            upper: What the other clock is ahead by no more than.
            lower: What it is ahead by no less than.
            expected_drift: The drift where these points show no other one [s/s].
            most_ns: No two lines are further apart than this [ns], as no round trip was longer; a drift that would
                bring them so far apart comes from points that stand for others of their time.
        """
        origin_ns, base_ns = upper[0]
        # Both clouds become points above a line: those from below change their sign, and so does the slope.
        above = [(at_ns - origin_ns, value_ns - base_ns) for at_ns, value_ns in upper]
        below = [(at_ns - origin_ns, base_ns - value_ns) for at_ns, value_ns in lower]
        highs, lows = _hull(above), _hull(below)

        def distance_ns(slope: float) -> float:
            return _least(highs, slope) + _least(lows, -slope)

        slopes = [slope for slope in (*_slopes(highs), *(-s for s in _slopes(lows))) if abs(slope) <= MOST_DRIFT]
        slopes = [slope for slope in slopes if distance_ns(slope) <= most_ns]
        widest = max((expected_drift, *slopes), key=distance_ns)
        scatter_ns = _scatter(above, highs, widest) + _scatter(below, lows, -widest)
        expected_ns = distance_ns(expected_drift)
        gain_ns, chance_ns = distance_ns(widest) - expected_ns, max(LEAST_GAIN_NS, scatter_ns * _FEW / len(upper))
        if gain_ns > chance_ns:
            shown = ClockLine(origin_ns, float(base_ns), widest, 0.0, 0.0)
            times = _correlation_times([(shown, Bounds(upper, lower))])
            chance_ns = max(LEAST_GAIN_NS, scatter_ns * _FEW * times / len(upper))
        is_shown = expected_ns < 0.0 or gain_ns > chance_ns
        drift = widest if is_shown else expected_drift
        ahead_ns = base_ns + 0.5 * (_least(highs, drift) - _least(lows, -drift))
        return ClockLine(origin_ns, ahead_ns, drift, distance_ns(drift), chance_ns)


class Bounds(NamedTuple):
    """Bounds of what the other clock is ahead in some time, from above and from below; neither is empty."""

    upper: Sequence[Bound]
    lower: Sequence[Bound]


def are_apart(whole: ClockLine, parts: Sequence[tuple[ClockLine, Bounds]], looks: int = 1) -> bool:
    """Return whether a line for each of two parts fits them better than one for both, by more than chance.

    The other clock has changed its rate or was set in between then; a network that has become slower does not do that.
    What chance does has the uncertainty of both parts: if the clock stays as it is, its lowest bounds from above and
    its highest from below may be in either part, as often as that has bounds. So it is counted how many of the ones
    are lower than all in the other part, and how many of the others, there, are higher than all in the first, in
    correlation times of the bounds about their own line (the tails of Tukey's quick test, Technometrics 1, 1959).

    Args:
        whole: The line of both parts.
        parts: The line of the older part, then that of the newer one, each with the bounds that it is of.
        looks: How many comparisons of a session are made, of which hardly any is to be wrong.
    """
    if whole.round_trip_ns < 0.0:
        return True
    if min(line.round_trip_ns for line, _ in parts) - whole.round_trip_ns <= LEAST_GAIN_NS:
        return False
    uppers, lowers = (
        [[sign * (value - whole.at(at_ns)) for at_ns, value in bounds[side]] for _, bounds in parts]
        for side, sign in ((0, 1), (1, -1))
    )
    times = _correlation_times(parts)
    chance = min(_tails(uppers, lowers[::-1], times), _tails(uppers[::-1], lowers, times))
    return 2 * looks * chance <= _BY_CHANCE


def _tails(first: Sequence[Sequence[float]], second: Sequence[Sequence[float]], times: float) -> float:
    """Return the chance that the least of both are where they are: of the first of each, so many below all others."""
    chance = 1.0
    for ours, others in (first, second):
        below = sum(value < min(others) for value in ours) / times
        chance *= (len(ours) / (len(ours) + len(others))) ** below
    return chance


def _correlation_times(parts: Sequence[tuple[ClockLine, Bounds]]) -> float:
    """Return how many neighbouring bounds are as good as one, of those from above or below, whichever is more.

    Each part has a line of its own, so that a change between parts is no correlation. It is the sum of the correlations
    at all lags either way, up to the first that could be chance.
    """
    most = 1.0
    for side in (0, 1):
        courses = []
        for line, bounds in parts:
            values = [value - line.at(at_ns) for at_ns, value in bounds[side]]
            mean = sum(values) / len(values)
            courses.append([value - mean for value in values])
        square = sum(value * value for course in courses for value in course)
        count = sum(map(len, courses))
        times = 1.0
        for lag in range(1, count // 4 if square > count * _EXACT_NS**2 else 0):
            share = sum(sum(map(operator.mul, course, course[lag:])) for course in courses) / square
            if share < 1.0 / math.sqrt(count):
                break
            times += 2.0 * share
        most = max(most, times)
    return most


def _hull(points: Iterable[Bound]) -> list[Bound]:
    """Return the corners of the lower convex hull of points, from left to right (Andrew's monotone chain)."""
    corners: list[Bound] = []
    for x, y in sorted(points):
        while len(corners) > 1:
            (x1, y1), (x2, y2) = corners[-2:]
            if (x2 - x1) * (y - y1) > (y2 - y1) * (x - x1):
                break
            corners.pop()
        if corners and corners[-1][0] == x:
            continue
        corners.append((x, y))
    return corners


def _slopes(corners: Sequence[Bound]) -> list[float]:
    return [(y2 - y1) / (x2 - x1) for (x1, y1), (x2, y2) in itertools.pairwise(corners)]


def _least(corners: Sequence[Bound], slope: float) -> float:
    """Return where the highest line of a slope below the corners is at the origin [ns]."""
    return min(y - slope * x for x, y in corners)


def _scatter(points: Sequence[Bound], corners: Sequence[Bound], slope: float) -> float:
    """Return the median distance of points from the line of a slope that touches their hull [ns]."""
    off = sorted(y - slope * x for x, y in points)
    return off[len(off) // 2] - _least(corners, slope)

"""Linear fit of another clock's lead over this one, from the fastest messages in both directions.

It is the only clock estimate of the project: for the last seconds on a link (`telenano.timing.clock_offset`), for the
detection of queues on a line between two machines, and for the parts of a recording
(`telenano.recording.clock_course`).

For a message sent at t1 by this clock and received at t2 by the other one, t2 - t1 is its delay plus the lead of the
other clock, thus an upper bound of the lead. An answer sent at t3 and received at t4 gives the lower bound t3 - t4.
Queues only lengthen a delay. So the lead lies below all upper bounds and above all lower ones. Two parallel lines
between them, as far apart as possible, have the drift as their slope (the convex hull method). Their middle is the
estimate. Half their distance, which is half the shortest round trip, bounds its error, because no exchange can
distinguish a clock offset from unequal delays.
"""

import itertools
import math
import operator
from collections.abc import Iterable, Sequence
from typing import NamedTuple

# A time by this clock [ns], and a bound of the other clock's lead at that time [ns].
Bound = tuple[int, int]

# Greatest drift of a computer's clock [s/s].
MOST_DRIFT = 2e-3
# A drift counts as proven only if it widens the distance of the lines by more than this [ns].
LEAST_GAIN_NS = 500_000.0
# Probability of a false report that a clock has changed, for a whole session.
_BY_CHANCE = 0.01
# Bounds that scatter by less are as exact as the stamps, so their residuals are rounding errors [ns].
_EXACT_NS = 1_000.0
# With this number of points on each side, chance widens the distance of the lines by about the scatter of the points;
# with more independent points, by less.
_FEW = 8


class ClockLine(NamedTuple):
    """Lead of the other clock: ahead_ns [ns] at the time origin_ns of this clock [ns], growing by drift [s/s].

    round_trip_ns: distance of the two lines [ns], negative if no line fits between the bounds. chance_ns: distance by
    which chance may widen the lines, given the number of points and their scatter [ns].
    """

    origin_ns: int
    ahead_ns: float
    drift: float
    round_trip_ns: float
    chance_ns: float

    def at(self, time_ns: int) -> float:
        """Return the lead of the other clock at a time of this one [ns]."""
        return self.ahead_ns + self.drift * (time_ns - self.origin_ns)

    @classmethod
    def through(
        cls,
        upper: Sequence[Bound],
        lower: Sequence[Bound],
        expected_drift: float = 0.0,
        most_ns: float = math.inf,
    ) -> "ClockLine":
        """Fit a line between upper and lower bounds, neither of which is empty.

        The best bound of each second suffices. A drift other than the expected one is accepted only if it widens the
        distance of the lines by more than chance does; a queue that fills in one direction does not do that.

        Args:
            upper: Upper bounds of the other clock's lead.
            lower: Lower bounds of the other clock's lead.
            expected_drift: The drift if the bounds prove no other one [s/s].
            most_ns: Greatest distance of the lines [ns], the longest round trip; a drift with a greater distance is an
                artefact of bounds that represent others of their time.
        """
        origin_ns, base_ns = upper[0]
        # Mirror the lower bounds (and their slope), so that both sets of points lie above a line.
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
    """Upper and lower bounds of the other clock's lead in some interval; neither is empty."""

    upper: Sequence[Bound]
    lower: Sequence[Bound]


def are_apart(whole: ClockLine, parts: Sequence[tuple[ClockLine, Bounds]], looks: int = 1) -> bool:
    """Return whether two lines fit two parts better than one line for both, by more than chance.

    This means that the other clock changed its rate or was set in between; a slower network does not have this effect.
    If the clock is unchanged, the lowest upper bounds and the highest lower bounds may be in either part, in proportion
    to its number of bounds. The test counts the upper bounds of one part below all of the other part, and the lower
    bounds of that other part above all of the first, in correlation times of the bounds about their own line (the tails
    of Tukey's quick test, Technometrics 1, 1959).

    Args:
        whole: The line of both parts.
        parts: The older part, then the newer one, each as its line and the bounds of that line.
        looks: Number of comparisons in a session, for which the probability of a false report is corrected.
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
    """Return the probability that chance puts as many values of each pair's first part below all of its second part."""
    chance = 1.0
    for ours, others in (first, second):
        below = sum(value < min(others) for value in ours) / times
        chance *= (len(ours) / (len(ours) + len(others))) ** below
    return chance


def _correlation_times(parts: Sequence[tuple[ClockLine, Bounds]]) -> float:
    """Return the correlation time of the bounds, in bounds: the greater one of upper and lower bounds.

    Residuals are taken from each part's own line, so that a change between parts is no correlation. The result is the
    sum of the autocorrelation over positive and negative lags, up to the first value that could be chance.
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
    """Return the value at the origin of the highest line with a slope below the corners [ns]."""
    return min(y - slope * x for x, y in corners)


def _scatter(points: Sequence[Bound], corners: Sequence[Bound], slope: float) -> float:
    """Return the median distance of points from the line with a slope that touches their hull [ns]."""
    off = sorted(y - slope * x for x, y in points)
    return off[len(off) // 2] - _least(corners, slope)

"""The present of a line: the least that an exchange of time stamps takes now, as it follows changes that last.

A queue never makes a way shorter, so that an exchange which takes less than any before is believed at once. An exchange
that takes longer may have met a queue, a stall or jitter, or the route may have become longer. What tells them apart is
how the delays go on. A queue fills and drains, and takes every value on its way; what was held up by a stall or by a
lost packet arrives in one go, each later message less late than the one before. A route has one new least delay from
one exchange to the next, and keeps it. So the exchanges since the line was last near its old least are held against one
another: where the least of each third of them is the same, the line has become longer. A fast exchange is enough to end
that, so that a queue which did stand still is forgotten as it drains. A delay that grows by more than about one
millisecond in a second is never followed while it grows.

This is the base delay of LEDBAT (RFC 6817) and the round trip of BBR (Cardwell and others, "BBR: congestion-based
congestion control", ACM Queue 14, 2016), whose windows forget an old least after minutes and after ten seconds.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import msgspec

# Exchanges within this time count as one, by the fastest of them [ns].
_BIN_NS = 10_000_000
# For this time exchanges are kept [ns], and this number of them in any case.
_KEPT_NS = 1_000_000_000
_KEPT = 6
# A longer way has to be seen for this time [ns], in this number of exchanges.
_SHORT_NS = 50_000_000
_FEWEST = 5
# A way that is longer without a jump has to be so for this time [ns].
_LONG_NS = 800_000_000
# Exchanges that are above this share of the rise are on the other side of the jump, and those below the other share on
# this side.
_ABOVE = 0.6
_BELOW = 0.2
# No more than this number of exchanges are in between, where a way jumps.
_BETWEEN = 2
# That jitter keeps so many exchanges above that share by chance is less likely than this.
_BY_CHANCE = 1e-4
# A jump is one from this on [ns].
_JUMP_NS = 2_000_000
# Within this the least of a second is that of the way [ns].
_SAME_NS = 500_000
# The least delays of a longer way are the same within this share of the rise, but within no more than the first and no
# less than the last of these [ns].
_FLAT_SHARE = 0.15
_FLAT_NS = 1_000_000
_FLAT_LEAST_NS = 300_000
# Or within so many times what neighbours differ by in the median.
_NEIGHBOURS = 1.5
# The least of two ways seen apart is below the least of both by no more than this, or than the delays scatter, unless a
# clock was set [ns].
_STEP_NS = 10_000_000
# A change from this on, and by this share, is worth telling of [ns].
_TOLD_NS = 5_000_000
_TOLD_SHARE = 0.1
# It has lasted for this time [ns].
_LASTED_NS = 200_000_000
# The bound below the least of some delays, in distances of the two least, that holds in nine of ten samples (Robson and
# Whitlock, "Estimation of a truncation point", Biometrika 51, 1964).
_FURTHER = 9


class Fastest(NamedTuple):
    """The fastest exchanges of some time, the last of which ended at at_ns: t2 - t1, t4 - t3 and their sum [ns].

    The two ways have what the other clock is ahead in them. Their sum is the least of any one exchange.
    """

    at_ns: int
    there_ns: int
    back_ns: int
    both_ns: int

    def joined(self, other: "Fastest") -> "Fastest":
        """Return the fastest of both times, at the time of this one."""
        return Fastest(self.at_ns, *map(min, self[1:], other[1:]))


class RoundTrip(NamedTuple):
    """The least round trip of the present [ns], the interval in which it is [ns], and since when it is so [ns].

    It is the sum of the fastest question and of the fastest answer, which need not be those of one exchange.
    """

    now_ns: int
    low_ns: int
    high_ns: int
    since_ns: int


class Changed(NamedTuple):
    """A change of the least round trip that has lasted: when it began, from and to what, with its interval [ns]."""

    at_ns: int
    before_ns: int
    after_ns: int
    low_ns: int
    high_ns: int


class LeastWays(NamedTuple):
    """What t2 - t1 and t4 - t3 are at least now [ns], seen last at at_ns [ns]."""

    at_ns: int
    there_ns: int
    back_ns: int


class LinePresent(msgspec.Struct, array_like=True):
    """The present of a line, both ways; it is its own state.

    least: what each way takes at least now; since_ns: since when; told_ns: the round trip that was told of last;
    newest: the exchanges of the last second; jumped: which ways last became longer from one exchange to the next, as a
    route does, and not by and by (1 there, 2 back, 3 both); asked_ns: when the newest question was sent.
    """

    least: LeastWays | None = None
    since_ns: int = 0
    told_ns: int = 0
    newest: list[Fastest] = msgspec.field(default_factory=list)
    jumped: int = 0
    asked_ns: int = -1

    def record(self, sent_ns: int, there_ns: int, back_ns: int, received_ns: int) -> bool:
        """Record an exchange of four time stamps; return whether the line is seen to have become longer with it."""
        there, back = there_ns - sent_ns, received_ns - back_ns
        one = Fastest(received_ns, there, back, there + back)
        least, newest = self.least, self.newest
        if least is None or (newest and received_ns < newest[-1].at_ns - _KEPT_NS):
            self.least, self.since_ns, self.newest = LeastWays(received_ns, there, back), received_ns, [one]
            self.told_ns = self.told_ns or there + back
            return False
        if there < least.there_ns or back < least.back_ns:
            self._fall(one, least)
        if sent_ns == self.asked_ns:
            # Two answers to one question say of its way once how long it was.
            return False
        self.asked_ns = sent_ns
        if newest and received_ns - newest[-1].at_ns < _BIN_NS:
            newest[-1] = newest[-1].joined(one)
            return False
        newest.append(one)
        while len(newest) > _KEPT and received_ns - newest[0].at_ns > _KEPT_NS:
            del newest[0]
        return self._follow(received_ns)

    def round_trip(self) -> RoundTrip | None:
        """Return the least round trip of the present; None before the first exchange."""
        if self.least is None:
            return None
        now_ns = max(0, self.least.there_ns + self.least.back_ns)
        low_ns = high_ns = 0
        for way, floor_ns in enumerate(self.least[1:], 1):
            seen = sorted(one[way] for one in self.newest)[:2] or [floor_ns]
            low_ns += min(floor_ns, seen[0]) - _FURTHER * (seen[-1] - seen[0])
            high_ns += max(floor_ns, seen[0])
        return RoundTrip(now_ns, max(0, low_ns - _SAME_NS), max(0, high_ns + _SAME_NS), self.since_ns)

    def copy(self) -> "LinePresent":
        """Return a copy that does not change with this one."""
        return LinePresent(self.least, self.since_ns, self.told_ns, list(self.newest), self.jumped, self.asked_ns)

    @property
    def is_in_doubt(self) -> bool:
        """Whether the newest exchanges took longer than the line is believed to take: more of them would tell."""
        if self.least is None or not self.newest:
            return False
        return any(
            min(one[way] for one in self.newest[-2:]) - floor_ns >= _JUMP_NS
            for way, floor_ns in enumerate(self.least[1:], 1)
        )

    def take_change(self, now_ns: int) -> Changed | None:
        """Return a change that has lasted and was not told of yet; it counts as told then."""
        found, before_ns = self.round_trip(), self.told_ns
        if found is None or now_ns - self.since_ns < _LASTED_NS:
            return None
        scatter_ns = _scatter([one.both_ns for one in self.newest])
        if abs(found.now_ns - before_ns) < max(_TOLD_NS, _TOLD_SHARE * before_ns, scatter_ns):
            return None
        self.told_ns = found.now_ns
        return Changed(self.since_ns, before_ns, found.now_ns, found.low_ns, found.high_ns)

    def _fall(self, one: Fastest, least: LeastWays) -> None:
        """Take what is less than the least of a way."""
        lower = LeastWays(one.at_ns, min(least.there_ns, one.there_ns), min(least.back_ns, one.back_ns))
        both = [one.both_ns, *(other.both_ns for other in self.newest)]
        if lower.there_ns + lower.back_ns < min(both) - max(_STEP_NS, _scatter(both)):
            # A clock was set: what the ways seemed to take before was by another one.
            lower = LeastWays(*one[:3])
            self.newest.clear()
        if least.there_ns + least.back_ns - lower.there_ns - lower.back_ns >= _JUMP_NS:
            self.since_ns = one.at_ns
        self.least = lower

    def _follow(self, now_ns: int) -> bool:
        """Follow what the exchanges of the last second say; return whether a way has become longer."""
        least, newest = self.least, self.newest
        if least is None or len(newest) < _FEWEST:
            return False
        is_old = now_ns - max(least.at_ns, self.since_ns, newest[0].at_ns) >= _LONG_NS
        floors_ns, begins_ns, jumped = list(least), [], 0
        for way in (1, 2):
            rise_ns = min(one[way] for one in newest[-_FEWEST:]) - least[way]
            if rise_ns <= _SAME_NS:
                if is_old:
                    # The clocks drift apart, so what a way seems to take is that of the last second.
                    floors_ns[way] = min(one[way] for one in newest if one.at_ns >= self.since_ns)
                continue
            first, is_jump = self._longer(way, least[way], rise_ns, now_ns)
            if first is None:
                continue
            floors_ns[way] = min(one[way] for one in newest[first:])
            if rise_ns >= _JUMP_NS:
                begins_ns.append(newest[first].at_ns)
                jumped |= way * is_jump
        if floors_ns[1:] != list(least[1:]) or is_old:
            self.least = LeastWays(now_ns, *floors_ns[1:])
        if begins_ns:
            self.since_ns, self.jumped = min(begins_ns), jumped
        return bool(begins_ns)

    def _longer(self, way: int, floor_ns: int, rise_ns: int, now_ns: int) -> tuple[int | None, bool]:
        """Return since which of the newest exchanges a way is longer for good, None where it is not; whether it jumped."""
        newest = self.newest
        above_ns = floor_ns + _ABOVE * rise_ns
        first = len(newest)
        while first and newest[first - 1][way] > above_ns:
            first -= 1
        if first == len(newest):
            return None, False
        lasts_ns = now_ns - newest[first].at_ns
        # By chance: as often as the exchanges before were there (Laplace's rule of succession).
        often = (1 + sum(one[way] > above_ns for one in newest[:first])) / (2 + first)
        before = newest[max(0, first - _BETWEEN - 1) : first]
        is_jump = (
            rise_ns >= _JUMP_NS
            and lasts_ns >= _SHORT_NS
            and any(one[way] <= floor_ns + _BELOW * rise_ns for one in before)
            and often ** (len(newest) - first) <= _BY_CHANCE
        )
        is_longer = is_jump or lasts_ns >= _LONG_NS
        run = [(one.at_ns, one[way]) for one in newest[first:]]
        return (first, is_jump) if is_longer and _is_flat(run, rise_ns) else (None, False)


def _scatter(delays_ns: Sequence[int]) -> int:
    """Return how far the median of some delays is above their least [ns]."""
    ordered = sorted(delays_ns)
    return ordered[len(ordered) // 2] - ordered[0] if ordered else 0


def _is_flat(run: Sequence[tuple[int, int]], rise_ns: int) -> bool:
    """Return whether delays are the same all along: the least of each third, within what neighbours differ by.

    Of what grows or falls evenly the thirds are several such distances apart.
    """
    begin_ns = run[0][0]
    third_ns = (run[-1][0] - begin_ns) / 3 + 1
    thirds: tuple[list[int], list[int], list[int]] = ([], [], [])
    for at_ns, delay_ns in run:
        thirds[int((at_ns - begin_ns) / third_ns)].append(delay_ns)
    if not all(thirds):
        return False
    lowest = [min(third) for third in thirds]
    apart_ns = sorted(abs(after - before) for (_, before), (_, after) in itertools.pairwise(run))[len(run) // 2 - 1]
    same_ns = max(_NEIGHBOURS * apart_ns, min(_FLAT_NS, max(_FLAT_LEAST_NS, round(_FLAT_SHARE * rise_ns))))
    return max(lowest) - min(lowest) <= same_ns

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
# A line that is longer without a jump has to be so for this time [ns].
_LONG_NS = 800_000_000
# Exchanges that are above this share of the rise are on the other side of the jump.
_ABOVE = 0.6
# That jitter keeps so many exchanges above that share by chance is less likely than this.
_BY_CHANCE = 1e-4
# A jump is one from this on [ns].
_JUMP_NS = 2_000_000
# Within this the least of a second is that of the line [ns].
_SAME_NS = 500_000
# The least delays of a longer way are the same within this share of the rise, but within no more than the first and no
# less than the last of these [ns].
_FLAT_NS = 1_000_000
_FLAT_SHARE = 0.15
_FLAT_LEAST_NS = 300_000
# The least of two ways seen apart is below the least of both by no more than this, unless a clock was set [ns].
_STEP_NS = 10_000_000
# A change from this on, and by this share, is worth telling of [ns].
_TOLD_NS = 5_000_000
_TOLD_SHARE = 0.1
# It has lasted for this time [ns].
_LASTED_NS = 200_000_000
# The bound below the least of some delays, in distances of the two least, that holds in nine of ten samples (Robson and
# Whitlock, "Estimation of a truncation point", Biometrika 51, 1964).
_BELOW = 9


class Fastest(NamedTuple):
    """The fastest exchange of some time, which ended at at_ns: the round trip, and the least t2 - t1 and t4 - t3 [ns].

    The two ways have what the other clock is ahead in them.
    """

    at_ns: int
    round_trip_ns: int
    there_ns: int
    back_ns: int

    def joined(self, other: "Fastest") -> "Fastest":
        """Return the fastest of both times, at the time of this one."""
        return Fastest(
            self.at_ns,
            min(self.round_trip_ns, other.round_trip_ns),
            min(self.there_ns, other.there_ns),
            min(self.back_ns, other.back_ns),
        )


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


class LinePresent(msgspec.Struct, array_like=True):
    """The present of a line, both ways; it is its own state.

    least: the fastest exchange that the line allows now; since_ns: since when; told_ns: the round trip that was told
    of last; newest: the exchanges of the last second.
    """

    least: Fastest | None = None
    since_ns: int = 0
    told_ns: int = 0
    newest: list[Fastest] = msgspec.field(default_factory=list)

    def record(self, sent_ns: int, there_ns: int, back_ns: int, received_ns: int) -> bool:
        """Record an exchange of four time stamps; return whether the line is seen to have become longer with it."""
        there, back = there_ns - sent_ns, received_ns - back_ns
        one = Fastest(received_ns, there + back, there, back)
        least, newest = self.least, self.newest
        if least is None or (newest and received_ns < newest[-1].at_ns - _KEPT_NS):
            self.least, self.since_ns, self.newest = one, received_ns, [one]
            self.told_ns = self.told_ns or one.round_trip_ns
            return False
        if there < least.there_ns or back < least.back_ns or one.round_trip_ns < least.round_trip_ns:
            self._fall(one, least)
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
        seen = sorted(one.round_trip_ns for one in self.newest)[:2] or [now_ns]
        low_ns = min(now_ns, seen[0]) - _BELOW * (seen[-1] - seen[0]) - _SAME_NS
        return RoundTrip(now_ns, max(0, low_ns), max(now_ns, seen[0]) + _SAME_NS, self.since_ns)

    def copy(self) -> "LinePresent":
        """Return a copy that does not change with this one."""
        return LinePresent(self.least, self.since_ns, self.told_ns, list(self.newest))

    @property
    def is_in_doubt(self) -> bool:
        """Whether the newest exchanges took longer than the line is believed to take: more of them would tell."""
        if self.least is None or not self.newest:
            return False
        lately = min(one.round_trip_ns for one in self.newest[-2:])
        return lately - self.least.round_trip_ns >= _JUMP_NS

    def take_change(self, now_ns: int) -> Changed | None:
        """Return a change that has lasted and was not told of yet; it counts as told then."""
        found, before_ns = self.round_trip(), self.told_ns
        if found is None or now_ns - self.since_ns < _LASTED_NS:
            return None
        if abs(found.now_ns - before_ns) < max(_TOLD_NS, _TOLD_SHARE * before_ns, _scatter(self.newest)):
            return None
        self.told_ns = found.now_ns
        return Changed(self.since_ns, before_ns, found.now_ns, found.low_ns, found.high_ns)

    def _fall(self, one: Fastest, least: Fastest) -> None:
        """Take what is less than the least."""
        lower = least.joined(one)
        if lower.there_ns + lower.back_ns < lower.round_trip_ns - _STEP_NS:
            # A clock was set: what the ways seemed to take before was by another one.
            lower = one._replace(round_trip_ns=lower.round_trip_ns)
            self.newest.clear()
        if least.round_trip_ns - lower.round_trip_ns >= _JUMP_NS:
            self.since_ns = one.at_ns
        self.least = lower

    def _follow(self, now_ns: int) -> bool:
        least, newest = self.least, self.newest
        if least is None or len(newest) < _FEWEST:
            return False
        rise_ns = min(one.round_trip_ns for one in newest[-_FEWEST:]) - least.round_trip_ns
        if rise_ns <= _SAME_NS:
            if now_ns - max(least.at_ns, newest[0].at_ns) >= _LONG_NS:
                # The clocks drift apart, so what the ways seem to take is that of the last second.
                self.least = _fastest(newest)._replace(at_ns=now_ns)
            return False
        above_ns = least.round_trip_ns + _ABOVE * rise_ns
        first = len(newest)
        while first and newest[first - 1].round_trip_ns > above_ns:
            first -= 1
        run = newest[first:]
        lasts_ns = now_ns - run[0].at_ns
        # By chance: as often as the exchanges before were there (Laplace's rule of succession).
        often = (1 + sum(one.round_trip_ns > above_ns for one in newest[:first])) / (2 + first)
        is_jump = rise_ns >= _JUMP_NS and lasts_ns >= _SHORT_NS and often ** len(run) <= _BY_CHANCE
        if not (is_jump or lasts_ns >= _LONG_NS) or not _is_flat(run, rise_ns):
            return False
        self.least = _fastest(run)._replace(at_ns=now_ns)
        if rise_ns >= _JUMP_NS:
            self.since_ns = run[0].at_ns
        self.newest = run
        return rise_ns >= _JUMP_NS


def _fastest(some: Sequence[Fastest]) -> Fastest:
    found = some[0]
    for one in some[1:]:
        found = found.joined(one)
    return found


def _scatter(some: Sequence[Fastest]) -> int:
    """Return how far the median round trip of some exchanges is above their least [ns]."""
    delays = sorted(one.round_trip_ns for one in some)
    return delays[len(delays) // 2] - delays[0] if delays else 0


def _is_flat(run: Sequence[Fastest], rise_ns: int) -> bool:
    """Return whether delays are the same all along: the least of each third, within what they scatter by themselves.

    What grows or falls evenly scatters by half of what it grows, and its thirds are two thirds of that apart.
    """
    third_ns = (run[-1].at_ns - run[0].at_ns) / 3 + 1
    lowest: list[int | None] = [None, None, None]
    for one in run:
        place = int((one.at_ns - run[0].at_ns) / third_ns)
        before = lowest[place]
        lowest[place] = one.round_trip_ns if before is None else min(before, one.round_trip_ns)
    known = [value for value in lowest if value is not None]
    same_ns = max(_scatter(run), min(_FLAT_NS, max(_FLAT_LEAST_NS, round(_FLAT_SHARE * rise_ns))))
    return len(known) == len(lowest) and max(known) - min(known) <= same_ns

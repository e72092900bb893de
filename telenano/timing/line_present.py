"""The present of a line: the least that an exchange of time stamps takes now, as it follows changes that last.

A queue never makes a way shorter, so that an exchange which takes less than any before is believed at once. An exchange
that takes longer may have met a queue, a stall or jitter, or the route may have become longer. What tells them apart is
how the delays go on. A queue fills and drains, and takes every value on its way; what was held up by a stall or by a
lost packet arrives in one go, each later message less late than the one before. A route has one new least delay from
one exchange to the next, and keeps it. So the exchanges since the line was last near its old least are held against one
another: where the least of each third of them is the same, the line has become longer. Of those that came in one go the
last one alone counts, because something held the others up. A fast exchange is enough to end that, so that a queue
which did stand still is forgotten as it drains. A delay that grows by more than about one millisecond in a second is
never followed while it grows.

This is the base delay of LEDBAT (RFC 6817) and the round trip of BBR (Cardwell and others, "BBR: congestion-based
congestion control", ACM Queue 14, 2016), whose windows forget an old least after minutes and after ten seconds.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import msgspec

# Messages within this time count as one, by the fastest of them [ns]: less than lies between two questions of a series,
# so that each of them counts.
_BIN_NS = 8_000_000
# Messages of different times that arrive within this time came in one go [ns].
_ONE_GO_NS = 500_000
# For this time messages are kept [ns], and this number of them in any case.
_KEPT_NS = 1_000_000_000
_KEPT = 6
# A longer way has to be seen for this time [ns], in this number of messages.
_SHORT_NS = 40_000_000
_FEWEST = 5
# A way that is longer without a jump has to be so for this time [ns].
_LONG_NS = 800_000_000
# Messages that are above this share of the rise are on the other side of the jump, and those below the other share on
# this side.
_ABOVE = 0.6
_BELOW = 0.2
# No more than this number of messages are in between, where a way jumps.
_BETWEEN = 2
# The last one on this side was sent no longer before the first one on the other side: of what lies further back it is
# open how it became longer, as where a process stood still and is behind [ns].
_NEAR_NS = 350_000_000
# That jitter keeps so many messages above that share by chance is less likely than this.
_BY_CHANCE = 1e-4
# A change is one from this on [ns], and a jump from that on: shorter queues come and go within a millisecond.
_CHANGE_NS = 2_000_000
_JUMP_NS = 5_000_000
# Within this the least of a second is that of the way [ns].
_SAME_NS = 500_000
# The least delays of a longer way are the same within this share of the rise, but within no more than the first and no
# less than the last of these [ns].
_FLAT_SHARE = 0.15
_FLAT_NS = 1_000_000
_FLAT_LEAST_NS = 300_000
# Or within so many times what neighbours differ by in the median.
_NEIGHBOURS = 1.5
# A clock was set if one way takes less by this at least [ns], and the other one more by this share of that at least.
_STEP_NS = 10_000_000
_OTHER_WAY = 0.5
# This number of the newest exchanges show by how much round trips scatter.
_BOTH = 32
# A change from this on, and by this share, is worth telling of [ns].
_TOLD_NS = 5_000_000
_TOLD_SHARE = 0.1
# It has lasted for this time [ns].
_LASTED_NS = 200_000_000
# The bound below the least of some delays, in distances of the two least, that holds in nine of ten samples (Robson and
# Whitlock, "Estimation of a truncation point", Biometrika 51, 1964).
_FURTHER = 9


class RoundTrip(NamedTuple):
    """The least round trip of the present [ns], the interval in which it is [ns], and since when it is so [ns].

    It is the sum of the fastest question and of the fastest answer, which need not be those of one exchange.
    """

    now_ns: int
    low_ns: int
    high_ns: int
    since_ns: int


class RouteChange(NamedTuple):
    """A change of the least round trip that has lasted: when it began, from and to what, with its interval [ns]."""

    at_ns: int
    before_ns: int
    after_ns: int
    low_ns: int
    high_ns: int


class Way(msgspec.Struct, array_like=True):
    """The present of one way: the least that a message takes, with what the clocks are apart in it [ns].

    least_ns: that; at_ns: when it was sent that took so little, by its sender's clock; since_ns: since when it is so,
    by that clock; jumped_ns: by how much it became longer last; newest: when those of the last second were sent, and
    what they took; is_jump: whether it became longer at once then, and not by and by.
    """

    least_ns: int
    at_ns: int
    since_ns: int
    jumped_ns: int = 0
    newest: list[tuple[int, int]] = msgspec.field(default_factory=list)
    is_jump: bool = True

    def record(self, sent_ns: int, took_ns: int) -> int:
        """Record a message and what it took; return by how much the way is seen with it to have become longer [ns].

        What comes in one go after a stall was sent at times of its own, so that these are the times that count.
        """
        newest = self.newest
        if took_ns < self.least_ns:
            if self.least_ns - took_ns >= _CHANGE_NS:
                self.since_ns = sent_ns
            self.least_ns, self.at_ns = took_ns, sent_ns
        if newest:
            before_ns, before = newest[-1]
            if sent_ns - before_ns < _BIN_NS:
                if took_ns < before and sent_ns >= before_ns:
                    newest[-1] = (before_ns, took_ns)
                return 0
            if sent_ns >= before_ns and abs(sent_ns + took_ns - before_ns - before) <= _ONE_GO_NS:
                # Both came in one go: something held the earlier one up, as a packet of TCP that is sent again does.
                del newest[-1]
        newest.append((sent_ns, took_ns))
        while len(newest) > _KEPT and sent_ns - newest[0][0] > _KEPT_NS:
            del newest[0]
        return self._follow(sent_ns)

    def begin(self, sent_ns: int, took_ns: int) -> None:
        """Begin again: a clock was set."""
        self.least_ns, self.at_ns, self.since_ns = took_ns, sent_ns, sent_ns
        self.newest.clear()

    @property
    def is_in_doubt(self) -> bool:
        """Whether the newest messages took longer than the way is believed to take."""
        return bool(self.newest) and min(took for _, took in self.newest[-2:]) - self.least_ns >= _CHANGE_NS

    def interval(self) -> tuple[int, int]:
        """Return the interval in which the least is [ns]."""
        seen = sorted(took for _, took in self.newest)[:2] or [self.least_ns]
        return min(self.least_ns, seen[0]) - _FURTHER * (seen[-1] - seen[0]), max(self.least_ns, seen[0])

    def _follow(self, now_ns: int) -> int:
        newest = self.newest
        if len(newest) < _FEWEST:
            return 0
        rise_ns = min(took for _, took in newest[-_FEWEST:]) - self.least_ns
        if rise_ns <= _SAME_NS:
            if now_ns - max(self.at_ns, self.since_ns, newest[0][0]) >= _LONG_NS:
                # The clocks drift apart, so what the way seems to take is that of the last second.
                self.least_ns, self.at_ns = min(took for at_ns, took in newest if at_ns >= self.since_ns), now_ns
            return 0
        above_ns = self.least_ns + _ABOVE * rise_ns
        first = len(newest)
        while first and newest[first - 1][1] > above_ns:
            first -= 1
        run = newest[first:]
        lasts_ns = now_ns - run[0][0]
        is_jump = rise_ns >= _JUMP_NS and lasts_ns >= _SHORT_NS and self._jumps(first, rise_ns)
        if not (is_jump or lasts_ns >= _LONG_NS) or not _is_flat(run, rise_ns):
            return 0
        longer_ns = min(took for _, took in run) - self.least_ns
        self.least_ns, self.at_ns = self.least_ns + longer_ns, now_ns
        if rise_ns < _CHANGE_NS:
            return 0
        self.since_ns, self.jumped_ns, self.is_jump = run[0][0], longer_ns, is_jump
        return longer_ns

    def _jumps(self, first: int, rise_ns: int) -> bool:
        """Return whether what the way takes is so from one message to the next, and not by chance."""
        newest, above_ns = self.newest, self.least_ns + _ABOVE * rise_ns
        # By chance: as often as the messages before were there (Laplace's rule of succession).
        often = (1 + sum(took > above_ns for _, took in newest[:first])) / (2 + first)
        before = newest[max(0, first - _BETWEEN - 1) : first]
        near_ns, below_ns = newest[first][0] - _NEAR_NS, self.least_ns + _BELOW * rise_ns
        was_near = any(at_ns >= near_ns and took <= below_ns for at_ns, took in before)
        return was_near and often ** (len(newest) - first) <= _BY_CHANCE


class LinePresent(msgspec.Struct, array_like=True):
    """The present of a line, both ways; it is its own state.

    there, back: the ways, None before the first exchange; since_ns: since when the round trip is so; told_ns: the round
    trip that was told of last; both_ns: the round trips of the newest exchanges; jumped_ns: by how much each way became
    longer at the last change.
    """

    there: Way | None = None
    back: Way | None = None
    since_ns: int = 0
    told_ns: int = 0
    both_ns: list[int] = msgspec.field(default_factory=list)
    jumped_ns: tuple[int, int] = (0, 0)

    def record(self, sent_ns: int, there_ns: int, back_ns: int, received_ns: int) -> bool:
        """Record an exchange of four time stamps; return whether the line is seen to have become longer with it."""
        took_there, took_back = there_ns - sent_ns, received_ns - back_ns
        there, back, both_ns = self.there, self.back, took_there + took_back
        if there is None or back is None or received_ns < self.since_ns:
            self.there, self.back = Way(took_there, sent_ns, sent_ns), Way(took_back, back_ns, back_ns)
            self.since_ns, self.told_ns, self.both_ns = received_ns, self.told_ns or both_ns, [both_ns]
            return False
        falls_ns = there.least_ns - took_there, back.least_ns - took_back
        if max(falls_ns) >= _STEP_NS and min(falls_ns) <= -_OTHER_WAY * max(falls_ns):
            # A clock was set, which takes off one way what it adds to the other.
            there.begin(sent_ns, took_there)
            back.begin(back_ns, took_back)
        elif max(falls_ns) >= _CHANGE_NS:
            self.since_ns = received_ns
        self.both_ns.append(both_ns)
        del self.both_ns[:-_BOTH]
        longer = there.record(sent_ns, took_there) > 0, back.record(back_ns, took_back) > 0
        if not any(longer):
            return False
        self.jumped_ns = (there.jumped_ns if longer[0] else 0, back.jumped_ns if longer[1] else 0)
        self.since_ns = received_ns - max(
            way.newest[-1][0] - way.since_ns for way, is_longer in zip((there, back), longer, strict=True) if is_longer
        )
        return True

    def round_trip(self) -> RoundTrip | None:
        """Return the least round trip of the present; None before the first exchange."""
        if self.there is None or self.back is None:
            return None
        now_ns = max(0, self.there.least_ns + self.back.least_ns)
        low_ns, high_ns = map(sum, zip(self.there.interval(), self.back.interval(), strict=True))
        return RoundTrip(now_ns, max(0, low_ns - _SAME_NS), max(0, high_ns + _SAME_NS), self.since_ns)

    @property
    def by_and_by(self) -> tuple[bool, bool]:
        """Whether each way became longer by and by at the last change, there and back, and not at once."""
        there, back = self.there, self.back
        return there is not None and not there.is_jump, back is not None and not back.is_jump

    @property
    def is_in_doubt(self) -> bool:
        """Whether the newest exchanges took longer than the line is believed to take: more of them would tell."""
        return any(way is not None and way.is_in_doubt for way in (self.there, self.back))

    def take_change(self, now_ns: int) -> RouteChange | None:
        """Return a change that has lasted and was not told of yet; it counts as told then."""
        found, before_ns = self.round_trip(), self.told_ns
        if found is None or now_ns - self.since_ns < _LASTED_NS:
            return None
        if abs(found.now_ns - before_ns) < max(_TOLD_NS, _TOLD_SHARE * before_ns, _scatter(self.both_ns)):
            return None
        self.told_ns = found.now_ns
        return RouteChange(self.since_ns, before_ns, found.now_ns, found.low_ns, found.high_ns)


def _scatter(delays_ns: Sequence[int]) -> int:
    """Return how far the median of some delays is above their least [ns]."""
    ordered = sorted(delays_ns)
    return ordered[len(ordered) // 2] - ordered[0] if ordered else 0


def _is_flat(run: Sequence[tuple[int, int]], rise_ns: int) -> bool:
    """Return whether delays are the same all along: the least of each third, within what neighbours differ by.

    Of what grows or falls evenly the thirds are several such distances apart.
    """
    ends = [round(len(run) * third / 3) for third in range(4)]
    lowest = [min(delay_ns for _, delay_ns in run[begin:end]) for begin, end in itertools.pairwise(ends)]
    apart_ns = sorted(abs(after - before) for (_, before), (_, after) in itertools.pairwise(run))[len(run) // 2 - 1]
    same_ns = max(_NEIGHBOURS * apart_ns, min(_FLAT_NS, max(_FLAT_LEAST_NS, round(_FLAT_SHARE * rise_ns))))
    return max(lowest) - min(lowest) <= same_ns

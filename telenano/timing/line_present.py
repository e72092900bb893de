"""Estimate of a line's present least round trip, which follows lasting changes of the route but not queues.

A queue never shortens a delay, so an exchange that is faster than all before is accepted at once. A slower exchange may
come from a queue, a stall, jitter, or a longer route. The course of the delays distinguishes them. A queue fills and
drains through all values. Messages held up by a stall or a lost packet arrive together, each later one less delayed
than the one before. A new route has a new least delay from one exchange to the next, and keeps it. So the exchanges
since the line was last near its old minimum are compared: if the minimum of each third is the same, the line has become
longer. Of messages that arrived together only the last counts, because the others were held up. One fast exchange ends
this, so that a standing queue is forgotten when it drains. A delay that grows by more than about one millisecond per
second is never followed while it grows.

This is the base delay of LEDBAT (RFC 6817) and the round trip of BBR (Cardwell and others, "BBR: congestion-based
congestion control", ACM Queue 14, 2016), whose windows forget an old least after minutes and after ten seconds.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import msgspec

# Messages sent within this time count as one, the fastest of them [ns]. The questions of a series are further apart, so
# that each of them counts.
_BIN_NS = 8_000_000
# Messages that were sent at different times and arrive within this time arrived together [ns].
_ONE_GO_NS = 500_000
# Messages are kept for this time [ns], but at least `_KEPT` of them.
_KEPT_NS = 1_000_000_000
_KEPT = 6
# Least duration of a longer delay after a jump [ns], and least number of messages with it.
_SHORT_NS = 40_000_000
_FEWEST = 5
# Least duration of a longer delay without a jump [ns].
_LONG_NS = 800_000_000
# Messages above the share `_ABOVE` of the rise are behind the jump, those below the share `_BELOW` before it.
_ABOVE = 0.6
_BELOW = 0.2
# Most messages between the two sides of a jump.
_BETWEEN = 2
# Longest time between the last message before a jump and the first behind it [ns]. With a longer gap, such as after a
# stalled process that lags behind, the course of the rise is unknown.
_NEAR_NS = 350_000_000
# Greatest probability that jitter alone keeps so many messages above that share.
_BY_CHANCE = 1e-4
# Least size of a change, and of a jump [ns]; queues shorter than these come and go within a millisecond.
_CHANGE_NS = 2_000_000
_JUMP_NS = 5_000_000
# A minimum of the last second within this of the estimate confirms it [ns].
_SAME_NS = 500_000
# Minima of the thirds are equal within this share of the rise, limited to at most `_FLAT_NS` and at least
# `_FLAT_LEAST_NS` [ns].
_FLAT_SHARE = 0.15
_FLAT_NS = 1_000_000
_FLAT_LEAST_NS = 300_000
# Or within this multiple of the median difference between neighbours.
_NEIGHBOURS = 1.5
# A clock was set if one direction became faster by at least `_STEP_NS` [ns] and the other slower by at least the share
# `_OTHER_WAY` of that.
_STEP_NS = 10_000_000
_OTHER_WAY = 0.5
# Number of newest exchanges from which the scatter of round trips is taken.
_BOTH = 32
# Least change that is reported, absolute [ns] and as a share of the round trip.
_TOLD_NS = 5_000_000
_TOLD_SHARE = 0.1
# Least duration of a change before it is reported [ns].
_LASTED_NS = 200_000_000
# Lower confidence bound (90 %) of a truncated distribution, below the sample minimum, in distances of the two smallest
# values (Robson and Whitlock, "Estimation of a truncation point", Biometrika 51, 1964).
_FURTHER = 9


class RoundTrip(NamedTuple):
    """Present least round trip [ns], its confidence interval [ns], and the time since which it holds [ns].

    It is the sum of the fastest question and the fastest answer, which need not belong to one exchange.
    """

    now_ns: int
    low_ns: int
    high_ns: int
    since_ns: int


class RouteChange(NamedTuple):
    """A lasting change of the least round trip: its beginning, the old and the new value, and its interval [ns]."""

    at_ns: int
    before_ns: int
    after_ns: int
    low_ns: int
    high_ns: int


class Way(msgspec.Struct, array_like=True):
    """Present least delay of one direction; all delays include the offset between the clocks [ns].

    least_ns: the least delay; at_ns: send time of the message with it, by the sender's clock; since_ns: time since
    which it holds, by that clock; jumped_ns: size of the last increase; newest: send times and delays of the last
    second; is_jump: whether the last increase was a jump rather than gradual; between: most messages between the two
    sides of a jump.
    """

    least_ns: int
    at_ns: int
    since_ns: int
    jumped_ns: int = 0
    newest: list[tuple[int, int]] = msgspec.field(default_factory=list)
    is_jump: bool = True
    between: int = _BETWEEN

    def record(self, sent_ns: int, took_ns: int) -> int:
        """Record a message's send time and delay; return the increase of the least delay that it proves [ns], else 0.

        Send times are used, because messages that arrive together after a stall were sent at different times.
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
                # Both arrived together, so the earlier one was held up, for instance by a TCP retransmission.
                del newest[-1]
        newest.append((sent_ns, took_ns))
        while len(newest) > _KEPT and sent_ns - newest[0][0] > _KEPT_NS:
            del newest[0]
        return self._follow(sent_ns)

    def begin(self, sent_ns: int, took_ns: int) -> None:
        """Restart the estimate because a clock was set."""
        self.least_ns, self.at_ns, self.since_ns = took_ns, sent_ns, sent_ns
        self.newest.clear()

    @property
    def is_in_doubt(self) -> bool:
        """Whether the newest messages are slower than the estimate, so that it may have to rise."""
        return bool(self.newest) and min(took for _, took in self.newest[-2:]) - self.least_ns >= _CHANGE_NS

    def interval(self) -> tuple[int, int]:
        """Return the confidence interval of the least delay [ns]."""
        seen = sorted(took for _, took in self.newest)[:2] or [self.least_ns]
        return min(self.least_ns, seen[0]) - _FURTHER * (seen[-1] - seen[0]), max(self.least_ns, seen[0])

    def _follow(self, now_ns: int) -> int:
        newest = self.newest
        if len(newest) < _FEWEST:
            return 0
        rise_ns = min(took for _, took in newest[-_FEWEST:]) - self.least_ns
        if rise_ns <= _SAME_NS:
            if now_ns - max(self.at_ns, self.since_ns, newest[0][0]) >= _LONG_NS:
                # The clocks drift apart, so the apparent minimum is renewed from the last second.
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
        """Return whether the delay rose from one message to the next, and not by chance."""
        newest, above_ns = self.newest, self.least_ns + _ABOVE * rise_ns
        # Probability of a high delay by chance, from the messages before (Laplace's rule of succession).
        often = (1 + sum(took > above_ns for _, took in newest[:first])) / (2 + first)
        before = newest[max(0, first - self.between - 1) : first]
        near_ns, below_ns = newest[first][0] - _NEAR_NS, self.least_ns + _BELOW * rise_ns
        was_near = any(at_ns >= near_ns and took <= below_ns for at_ns, took in before)
        return was_near and often ** (len(newest) - first) <= _BY_CHANCE


class LinePresent(msgspec.Struct, array_like=True):
    """Present least delays of a line in both directions; the object is its own state for the journal.

    there, back: the directions, None before the first exchange; since_ns: time since which the round trip holds;
    told_ns: the last reported round trip; both_ns: round trips of the newest exchanges; jumped_ns: increase of each
    direction at the last change.
    """

    there: Way | None = None
    back: Way | None = None
    since_ns: int = 0
    told_ns: int = 0
    both_ns: list[int] = msgspec.field(default_factory=list)
    jumped_ns: tuple[int, int] = (0, 0)

    def record(self, sent_ns: int, there_ns: int, back_ns: int, received_ns: int) -> bool:
        """Record an exchange of four time stamps [ns]; return True if it proves that the line has become longer."""
        took_there, took_back = there_ns - sent_ns, received_ns - back_ns
        there, back, both_ns = self.there, self.back, took_there + took_back
        if there is None or back is None or received_ns < self.since_ns:
            self.there, self.back = Way(took_there, sent_ns, sent_ns), Way(took_back, back_ns, back_ns)
            self.since_ns, self.told_ns, self.both_ns = received_ns, self.told_ns or both_ns, [both_ns]
            return False
        falls_ns = there.least_ns - took_there, back.least_ns - took_back
        if max(falls_ns) >= _STEP_NS and min(falls_ns) <= -_OTHER_WAY * max(falls_ns):
            # A clock was set, which shortens one apparent delay by as much as it lengthens the other.
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
        """Return the present least round trip; None before the first exchange."""
        if self.there is None or self.back is None:
            return None
        now_ns = max(0, self.there.least_ns + self.back.least_ns)
        low_ns, high_ns = map(sum, zip(self.there.interval(), self.back.interval(), strict=True))
        return RoundTrip(now_ns, max(0, low_ns - _SAME_NS), max(0, high_ns + _SAME_NS), self.since_ns)

    @property
    def by_and_by(self) -> tuple[bool, bool]:
        """Whether the last increase was gradual rather than a jump, there and back."""
        there, back = self.there, self.back
        return there is not None and not there.is_jump, back is not None and not back.is_jump

    @property
    def is_in_doubt(self) -> bool:
        """Whether the newest exchanges are slower than the estimate, so that further exchanges are useful."""
        return any(way is not None and way.is_in_doubt for way in (self.there, self.back))

    def take_change(self, now_ns: int) -> RouteChange | None:
        """Return a lasting change that was not reported yet, and mark it as reported; None if there is none."""
        found, before_ns = self.round_trip(), self.told_ns
        if found is None or now_ns - self.since_ns < _LASTED_NS:
            return None
        if abs(found.now_ns - before_ns) < max(_TOLD_NS, _TOLD_SHARE * before_ns, _scatter(self.both_ns)):
            return None
        self.told_ns = found.now_ns
        return RouteChange(self.since_ns, before_ns, found.now_ns, found.low_ns, found.high_ns)


def _scatter(delays_ns: Sequence[int]) -> int:
    """Return the distance of the median of delays from their minimum [ns]."""
    ordered = sorted(delays_ns)
    return ordered[len(ordered) // 2] - ordered[0] if ordered else 0


def _is_flat(run: Sequence[tuple[int, int]], rise_ns: int) -> bool:
    """Return whether delays are constant: the minima of their thirds agree within the differences of neighbours.

    If delays grow or fall steadily, the minima differ by several such differences.
    """
    ends = [round(len(run) * third / 3) for third in range(4)]
    lowest = [min(delay_ns for _, delay_ns in run[begin:end]) for begin, end in itertools.pairwise(ends)]
    apart_ns = sorted(abs(after - before) for (_, before), (_, after) in itertools.pairwise(run))[len(run) // 2 - 1]
    same_ns = max(_NEIGHBOURS * apart_ns, min(_FLAT_NS, max(_FLAT_LEAST_NS, round(_FLAT_SHARE * rise_ns))))
    return max(lowest) - min(lowest) <= same_ns

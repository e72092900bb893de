"""How old the hand's sample is that a message descends from, and whether this process itself stalled.

Nothing here reads a clock: a node passes the time of its turn, so that a re-run from its journal decides the same.
"""

from bisect import bisect_right

from proto.messages import LinkDelay
from proto.nodes import LINK, name_of, site_of
from proto.topics import LOOP_DEADLINE_S
from services.runtime.loop.clock import NEVER_NS

LOOP_DEADLINE_NS = round(LOOP_DEADLINE_S * 1e9)
# the link reports its delay in steps of this, rounded down: an age may come out too great by less than one step
DELAY_STEP_NS = 1_000_000
# a sample this much older than its reader was never sent to it: it is played from a recording
_OLDER_THAN_READER_NS = 1_000_000_000
# changes of the delay in flight: a round trip of four seconds with a change at every sample
_MOST_CHANGES = 4096


class DelayHistory:
    """Delay of one direction by the hand's sample that a message descends from: where it changed, and to what."""

    def __init__(self) -> None:
        self.from_ns = [0]
        self.delay_ns = [0]

    def record(self, hand_t_ns: int, delay_ns: int) -> None:
        """Record the delay from a sample on; one before the last recorded means that a player went back in time."""
        if hand_t_ns > self.from_ns[-1]:
            self.from_ns.append(hand_t_ns)
            self.delay_ns.append(delay_ns)
            if len(self.from_ns) > _MOST_CHANGES:
                del self.from_ns[: _MOST_CHANGES // 2], self.delay_ns[: _MOST_CHANGES // 2]
        elif hand_t_ns == self.from_ns[-1]:
            self.delay_ns[-1] = delay_ns
        else:
            self.from_ns, self.delay_ns = [hand_t_ns], [delay_ns]

    def of(self, hand_t_ns: int) -> int:
        """Return the delay [ns] of what descends from a sample, 0 where none was reported."""
        place = bisect_right(self.from_ns, hand_t_ns) - 1
        return self.delay_ns[place] if place >= 0 else 0

    def forget_before(self, hand_t_ns: int) -> None:
        """Forget what applies to older samples only: a reader of `latest` topics never goes back."""
        place = bisect_right(self.from_ns, hand_t_ns) - 1
        if place > 0:
            del self.from_ns[:place], self.delay_ns[:place]


class HandAge:
    """The age of the hand's samples at one node, less what link/delay accounts for.

    At the slave's site a sample came through the forward direction, and its stamp is of the master's clock. At the
    master's it came back, so both directions count and the clock is that of the stamp.
    """

    def __init__(self, node: str, now_ns: int) -> None:
        self._is_slave = site_of(node) == "slave"
        self._oldest_ns = now_ns - _OLDER_THAN_READER_NS
        self._forward, self._backward = DelayHistory(), DelayHistory()
        self._between_ns = 0
        self._judged_ns = 0
        # what applies to the newest samples, without a look into the histories
        self._newest_from_ns = self._newest_lag_ns = 0

    def record(self, message: LinkDelay) -> None:
        """Record what the link reports of one direction; nobody else knows it."""
        if name_of(message.src) != LINK:
            return
        forward, backward = self._forward, self._backward
        for history in (forward, backward):
            history.forget_before(self._judged_ns)
        (forward if message.direction == "forward" else backward).record(message.hand_t_ns, message.delay_ns)
        transit_ns = message.transit_ns
        self._between_ns = transit_ns + message.clock_ahead_ns if self._is_slave else 2 * transit_ns
        self._newest_from_ns = max(forward.from_ns[-1], backward.from_ns[-1])
        self._newest_lag_ns = self.lag_ns(self._newest_from_ns)

    def lag_ns(self, hand_t_ns: int) -> int:
        """Return what link, network and clocks add to the age of a sample [ns]."""
        lag_ns = self._between_ns + self._forward.of(hand_t_ns)
        return lag_ns if self._is_slave else lag_ns + self._backward.of(hand_t_ns)

    def age_s(self, now_ns: int, hand_t_ns: int, message_age_s: float = 0.0) -> float:
        """Return the greater of the age of a sample and of the message that descends from it [s].

        A sample from before this node began is played from a recording and has no age here: the message's counts. (A
        live one cannot be so old: nothing was sent to this node before it subscribed.)
        """
        self._judged_ns = hand_t_ns
        is_newest = hand_t_ns >= self._newest_from_ns
        taken_ns = hand_t_ns + (self._newest_lag_ns if is_newest else self.lag_ns(hand_t_ns))
        if taken_ns < self._oldest_ns:
            return message_age_s
        sample_age_s = age_s(now_ns, taken_ns)
        return sample_age_s if sample_age_s > message_age_s else message_age_s

    def message_age_s(self, now_ns: int, t_ns: int, received_ns: int, *, allow_replay: bool) -> float:
        """Return the age of a message by its own stamp, or, of a played one where that is allowed, by its reception."""
        return age_s(now_ns, received_ns if allow_replay and self.is_played(t_ns) else t_ns)

    def is_played(self, t_ns: int) -> bool:
        """Return whether a time stamp of this site's clock is from before this node began: it is from a recording."""
        return t_ns < self._oldest_ns


def age_s(now_ns: int, t_ns: int) -> float:
    """Return the age of a time stamp [s].

    One that is later than now by more than the deadline is as far off as one that is so much earlier: clock or delay
    are not what they are taken for.
    """
    age_ns = now_ns - t_ns
    return (age_ns if age_ns >= -LOOP_DEADLINE_NS else -age_ns) * 1e-9


class StallDetector:
    """Detects from the clock that a process stood still: by the time between two of its turns.

    A node that takes a turn at least every `deadline_ns` is late by half of the bound and more where two turns lie
    further apart than the bound, the deadline of the loop.
    """

    def __init__(self) -> None:
        # 0: no turn yet; what comes before the first may take any time
        self.turn_ns = 0

    def deadline_ns(self) -> int:
        """Return when to take a turn at the latest [ns]."""
        return self.turn_ns + LOOP_DEADLINE_NS // 2 if self.turn_ns else NEVER_NS

    def stalled_s(self, now_ns: int) -> float:
        """Return how long ago the last turn was [s] where that is beyond the bound, else 0.0; this is the next turn."""
        gap_ns, self.turn_ns = now_ns - self.turn_ns, now_ns
        return gap_ns * 1e-9 if LOOP_DEADLINE_NS < gap_ns < now_ns else 0.0

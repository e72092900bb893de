"""Ages of messages and of the hand's samples behind them, and detection of stalls of this process.

Nothing here reads a clock: the node passes the time of its turn, so that a re-run from its journal decides the same.
"""

import math
from bisect import bisect_right
from typing import NamedTuple, cast

import msgspec

from telenano.timing.clock import NEVER_NS
from telenano.timing.longer_way import LongerWay
from telenano.wire.messages import AfmCommand, HapticCommand, LinkDelay, TeleopBackward, TeleopForward
from telenano.wire.nodes import LINK, name_of, site_of
from telenano.wire.received import Received
from telenano.wire.topics import LOOP_DEADLINE_S, deadline_of

LOOP_DEADLINE_NS = round(LOOP_DEADLINE_S * 1e9)
# Greatest age at which a controller still uses a sample or signal, by topic [s].
_SIGNALS = ("teleop/forward", "teleop/backward")
DEADLINES_S = {topic: deadline_of(topic) for topic in ("haptic/state", "afm/state", *_SIGNALS)}
# A sample that is older than its reader by more than this was never sent to it, so it comes from a recording.
_OLDER_THAN_READER_NS = 1_000_000_000
# Messages between the two sides of a jump of a round trip, whose way there becomes longer before its way back.
_THERE_BEFORE_BACK = 16
# Most recorded changes of the delay: enough for a round trip of four seconds with a change at every sample.
_MOST_CHANGES = 4096


class DelayHistory(msgspec.Struct, array_like=True):
    """Delay of one direction as a step function of the stamp of the hand's sample behind a message [ns]."""

    from_ns: list[int] = msgspec.field(default_factory=lambda: [0])
    delay_ns: list[int] = msgspec.field(default_factory=lambda: [0])

    def record(self, hand_t_ns: int, delay_ns: int) -> None:
        """Record the delay from a sample on; an earlier sample than the last means that a player went back in time."""
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
        """Return the delay of messages that descend from a sample [ns]; 0 if none was reported."""
        place = bisect_right(self.from_ns, hand_t_ns) - 1
        return self.delay_ns[place] if place >= 0 else 0

    def forget_before(self, hand_t_ns: int) -> None:
        """Drop the entries that apply only to older samples: a reader of `latest` topics never goes back."""
        place = bisect_right(self.from_ns, hand_t_ns) - 1
        if place > 0:
            del self.from_ns[:place], self.delay_ns[:place]


class FreshnessState(NamedTuple):
    """Time since which a turn is due, oldest stamp of this session, and the delays that the link reported [ns].

    between_ns: delay of the network and lead of the clock. judged_ns: stamp of the sample whose age was last requested.
    """

    turn_ns: int
    oldest_ns: int
    forward: DelayHistory
    backward: DelayHistory
    between_ns: int
    judged_ns: int
    longer: LongerWay | None = None


class Freshness:
    """Three facts that decide whether a node may still act on an input.

    - The *age* of a message is the time since its own stamp.
    - The age of the hand's sample behind a message is the time since that sample, minus the delay that link/delay
      reports. At the slave's site the message came through the forward direction, and the stamp is by the master's
      clock. At the master's site it came back, so both directions count, and the stamp is by the local clock.
    - A *stall* is a time in which this process took no turn although one was due.
    """

    def __init__(self, node: str, now_ns: int) -> None:
        """Begin without a turn; `node` is node@site, `now_ns` the time by the clock of the stamps."""
        # Whether a message from a recording has the age since its reception.
        self.allow_replay = True
        # Time since which a turn is due, by the monotonic clock [ns]: that of the last turn, or a later deadline that
        # the node sets. 0 before the first turn, which may take any time.
        self.turn_ns = 0
        self._is_slave = site_of(node) == "slave"
        self._oldest_ns = now_ns - _OLDER_THAN_READER_NS
        self._forward, self._backward = DelayHistory(), DelayHistory()
        self._between_ns = 0
        self._judged_ns = 0
        # Cached lag of the newest samples.
        self._newest_from_ns = self._newest_lag_ns = 0
        self._longer = LongerWay(between=2 if self._is_slave else _THERE_BEFORE_BACK)
        # Topics whose newest message was too old, which is reported only once.
        self._late: set[str] = set()

    def capture(self) -> FreshnessState:
        """Return the state."""
        delays = self._forward, self._backward, self._between_ns
        return FreshnessState(self.turn_ns, self._oldest_ns, *delays, self._judged_ns, self._longer)

    def restore(self, state: FreshnessState) -> None:
        """Continue from a state."""
        self.turn_ns, self._oldest_ns, self._forward, self._backward, self._between_ns, self._judged_ns = state[:-1]
        self._longer = state.longer or LongerWay(between=self._longer.between)
        self._note_newest()

    def deadline_ns(self) -> int:
        """Return the latest time for the next turn, so that a stall is noticed [ns]."""
        return self.turn_ns + LOOP_DEADLINE_NS // 2 if self.turn_ns else NEVER_NS

    def stalled_s(self, now_ns: int) -> float:
        """Record a turn; return the time for which it was due [s] if that exceeds the deadline of the loop, else 0.0.

        Messages that waited during a stall are late, and are not reported as late once more.
        """
        gap_ns, self.turn_ns = now_ns - self.turn_ns, now_ns
        if not LOOP_DEADLINE_NS < gap_ns < now_ns:
            return 0.0
        self._late.update(DEADLINES_S)
        return gap_ns * 1e-9

    def record(self, message: LinkDelay) -> None:
        """Record the link's report on the delay of one direction; reports of other nodes are ignored."""
        if name_of(message.src) != LINK:
            return
        forward, backward = self._forward, self._backward
        for history in (forward, backward):
            # Keep one deadline more: an answer at the hand may be older than the last judged sample.
            history.forget_before(self._judged_ns - LOOP_DEADLINE_NS)
        (forward if message.direction == "forward" else backward).record(message.hand_t_ns, message.delay_ns)
        transit_ns, before_ns = message.transit_ns, self._between_ns
        self._between_ns = transit_ns + message.clock_ahead_ns if self._is_slave else 2 * transit_ns
        self._longer.reported(self._between_ns - before_ns)
        self._note_newest()

    def _note_newest(self) -> None:
        self._newest_from_ns = max(self._forward.from_ns[-1], self._backward.from_ns[-1])
        self._newest_lag_ns = self.lag_ns(self._newest_from_ns)

    def lag_ns(self, hand_t_ns: int) -> int:
        """Return the part of a sample's age that comes from link, network and clocks [ns]."""
        return self._between_ns + self._longer.more_ns + self._added_ns(hand_t_ns)

    def _added_ns(self, hand_t_ns: int) -> int:
        """Return the delay that the link adds on purpose to messages that descend from a sample [ns]."""
        added_ns = self._forward.of(hand_t_ns)
        return added_ns if self._is_slave else added_ns + self._backward.of(hand_t_ns)

    def arrived(self, hand_t_ns: int, received_ns: int) -> None:
        """Note that a message which descends from a sample of the hand has come now [ns]; the way may be longer.

        A sample from before this node began comes from a recording, and says nothing about the line.
        """
        if hand_t_ns - self._oldest_ns < 0 or not hand_t_ns:
            return
        added_ns = self._added_ns(hand_t_ns)
        changed = self._longer.arrived(hand_t_ns, received_ns, added_ns, self._between_ns)
        if self._longer.ends(received_ns) or changed:
            self._note_newest()

    def age_s(self, now_ns: int, hand_t_ns: int, message_age_s: float = 0.0) -> float:
        """Return the age of a hand's sample, or that of the message that descends from it, if greater [s].

        A sample from before this node began comes from a recording, so only the message's age counts. (A live sample
        cannot be so old: nothing was sent to this node before it subscribed.)
        """
        self._judged_ns = hand_t_ns
        is_newest = hand_t_ns >= self._newest_from_ns
        taken_ns = hand_t_ns + (self._newest_lag_ns if is_newest else self.lag_ns(hand_t_ns))
        if taken_ns < self._oldest_ns:
            return message_age_s
        sample_age_s = age_s(now_ns, taken_ns)
        return sample_age_s if sample_age_s > message_age_s else message_age_s

    def command_age_s(self, command: AfmCommand | HapticCommand | None, received_ns: int, now_ns: int) -> float:
        """Return the age of a command, or of the hand's sample that it answers, if greater [s]; inf without a command.

        For a haptic command in mode off, which moves nothing, only its own age counts.
        """
        if command is None:
            return math.inf
        command_age_s = age_s(now_ns, self.stamp_ns(command.t_ns, received_ns))
        if type(command) is HapticCommand and command.mode == "off":
            return command_age_s
        return self.age_s(now_ns, command.hand_t_ns, command_age_s)

    def answer_age_s(self, sampled_ns: int, answered_ns: int) -> float:
        """Return the age of the newest answer that a hand has received at one of its samples [s]; inf before the first.

        Both stamps are by the hand's clock: of the sample, and of the earlier sample from which the answer descends. No
        other clock is involved. A sample from a recording has the age 0.
        """
        if self.allow_replay and sampled_ns < self._oldest_ns:
            return 0.0
        if not answered_ns:
            return math.inf
        is_newest = answered_ns >= self._newest_from_ns
        return age_s(sampled_ns, answered_ns + (self._newest_lag_ns if is_newest else self.lag_ns(answered_ns)))

    def stamp_ns(self, t_ns: int, received_ns: int) -> int:
        """Return the time from which a message's age counts [ns]: its stamp, or its reception if it is replayed.

        A stamp from before this node began means that the message comes from a recording.
        """
        return received_ns if self.allow_replay and t_ns < self._oldest_ns else t_ns

    def rejection(self, received: Received) -> str | None:
        """Check the age of a controller's input: return None if it is fresh, else a sentence to report.

        The age of a device's sample at this site counts from its stamp, that of a signal of the other half from the
        hand's sample behind it. The sentence is empty if the previous message was too old as well.
        """
        topic, message = received.topic, received.message
        limit_s = DEADLINES_S.get(topic)
        if limit_s is None:
            return None
        if topic in _SIGNALS:
            hand_t_ns = cast(TeleopForward | TeleopBackward, message).hand_t_ns
            self.arrived(hand_t_ns, received.received_ns)
            old_s = self.age_s(received.received_ns, hand_t_ns)
        else:
            old_s = age_s(received.received_ns, self.stamp_ns(message.t_ns, received.received_ns))
        if old_s <= limit_s:
            self._late.discard(topic)
            return None
        if topic in self._late:
            return ""
        self._late.add(topic)
        age = f"{old_s * 1e3:.0f} ms off, of {limit_s * 1e3:.0f} ms allowed"
        return f"{topic} of {message.src} is {age}: it is rejected"


def age_s(now_ns: int, t_ns: int) -> float:
    """Return the age of a time stamp [s].

    A stamp in the future by more than the deadline returns its distance as an age, because the assumed clock offset or
    delay must be wrong.
    """
    age_ns = now_ns - t_ns
    return (age_ns if age_ns >= -LOOP_DEADLINE_NS else -age_ns) * 1e-9

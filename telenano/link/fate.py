"""Reports of the impairment engine: ground truth on each message, and live figures on all."""

from typing import Literal, NamedTuple

import msgspec

Direction = Literal["forward", "backward"]

CAUSES = ("outage", "loss", "markov_loss", "gilbert_elliott", "queue", "loss_trace")


class Fate(NamedTuple):
    """Ground truth of one message, or of one copy of it."""

    direction: Direction
    topic: str
    seq: int
    copy: int  # 0 the message itself, 1 its duplicate
    size_bytes: int
    arrived_ns: int
    release_ns: int | None = None  # None: dropped, or not decided yet
    delay_ns: int = 0  # release - arrival, everything included; 0 if dropped
    queue_ns: int = 0  # part of it waiting for, and being sent by, the rate limit or delivery trace
    held_ns: int = 0  # part of it waiting for the end of an outage
    dropped: str = ""  # one of CAUSES, empty if released
    duplicated: bool = False  # a copy was made of this message
    reordered: bool = False  # released before a message of its topic that had arrived earlier
    corrupted: bool = False  # bits were flipped
    src: str = ""  # publisher of the message, where it was given


def delayed(
    direction: Direction,
    topic: str,
    seq: int,
    size_bytes: int,
    arrived_ns: int,
    release_ns: int,
    delay_ns: int,
    reordered: bool,
    src: str,
) -> Fate:
    """Return the fate of a message on a plain bridge; calling the class with keywords takes nearly twice as long."""
    return Fate(
        direction, topic, seq, 0, size_bytes, arrived_ns, release_ns, delay_ns, 0, 0, "", False, reordered, False, src
    )


class Release(NamedTuple):
    """A message to send on now."""

    topic: str
    payload: bytes
    fate: Fate


class DirectionStats(NamedTuple):
    """Live figures of one direction: counts since the start, delays since the figures were last taken."""

    messages_in: int
    messages_out: int
    bytes_in: int
    bytes_out: int
    dropped: dict[str, int]  # every cause of CAUSES
    duplicated: int
    reordered: int
    corrupted: int
    queued: int  # waiting for the rate limit or delivery trace
    in_flight: int  # not released yet, those queued included
    delay_count: int  # messages released since the last call
    delay_mean_s: float | None  # None: nothing was released
    delay_min_s: float | None
    delay_max_s: float | None


class Figures(msgspec.Struct, array_like=True):
    """The counters behind the live figures; the last four cover the releases since the last `take`."""

    messages_in: int = 0
    messages_out: int = 0
    bytes_in: int = 0
    bytes_out: int = 0
    duplicated: int = 0
    reordered: int = 0
    corrupted: int = 0
    dropped: dict[str, int] = msgspec.field(default_factory=lambda: dict.fromkeys(CAUSES, 0))
    count: int = 0
    sum_ns: int = 0
    shortest_ns: int = 0
    longest_ns: int = 0

    def count_release(self, delay_ns: int, size_bytes: int) -> None:
        self.messages_out += 1
        self.bytes_out += size_bytes
        if self.count == 0 or delay_ns < self.shortest_ns:
            self.shortest_ns = delay_ns
        if delay_ns > self.longest_ns:
            self.longest_ns = delay_ns
        self.count += 1
        self.sum_ns += delay_ns

    def take(self, queued: int, scheduled: int) -> DirectionStats:
        """Return the figures and reset those of the delays; the arguments are numbers of messages in flight."""
        count = self.count
        stats = DirectionStats(
            messages_in=self.messages_in,
            messages_out=self.messages_out,
            bytes_in=self.bytes_in,
            bytes_out=self.bytes_out,
            dropped=dict(self.dropped),
            duplicated=self.duplicated,
            reordered=self.reordered,
            corrupted=self.corrupted,
            queued=queued,
            in_flight=queued + scheduled,
            delay_count=count,
            delay_mean_s=self.sum_ns / count * 1e-9 if count else None,
            delay_min_s=self.shortest_ns * 1e-9 if count else None,
            delay_max_s=self.longest_ns * 1e-9 if count else None,
        )
        self.count = self.sum_ns = self.shortest_ns = self.longest_ns = 0
        return stats

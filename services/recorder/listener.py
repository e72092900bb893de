"""A recorder's connection to one publisher: message by message, or in batches where the publisher makes them."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from proto.batch import BATCH_FRAME, read_batch
from proto.codec import WireError
from proto.sequence import SequenceTracker
from proto.topics import Topic
from services.runtime.bus import Subscriber

# a node sends its health twice a second, and with it a batch
_SILENT_NS = 1_200_000_000
# messages that may have come before the first batch, which has them as well: no more, and none that is older than that
_MOST_RECENT = 1024

# a process stands still for less; what is older was stamped by another clock
_LONGEST_STALL_NS = 3_600_000_000_000

Frames = Sequence[bytes]


@dataclass(slots=True)
class Stream:
    """What one publisher sends on one topic, received at one site.

    `live`: received at its publisher, with the stamps of this time: no queue is as long as those of a replay are old.
    """

    topic: Topic
    channel_topic: str
    src: str
    site: str
    channel: int | None
    direct: bool
    live: bool
    wanted: bool
    tracker: SequenceTracker


@dataclass
class Listener:
    """Connection to one publisher: what comes through it was received at that publisher's site.

    A `publisher` without a site stands for many, each of which is received at its own.
    """

    publisher: str
    subscriber: Subscriber
    streams: dict[tuple[bytes, str], Stream] = field(default_factory=dict)
    # everything that this publisher sends comes in batches, and nothing else is subscribed to
    batched: bool = False
    _accepts_batches: bool = False
    _last_batch_ns: int = 0
    _last_ns: int = 0
    # with the time of reception [ns]
    _recent: deque[tuple[int, Frames]] = field(default_factory=lambda: deque(maxlen=_MOST_RECENT))

    def accept_batches(self) -> None:
        """Ask for batches; until the first one comes, and when there are no more, the messages come one by one.

        For a publisher on this machine, whose batches have the times of its clock, and of which all is recorded.
        """
        self._accepts_batches = True
        self.subscriber.socket.subscribe(BATCH_FRAME)

    def receive(self, epoch_offset_ns: int) -> Iterator[tuple[int, Frames]]:
        """Yield what has arrived, in the order of sending: time of reception [ns], frames.

        Of a batch that is the time of sending, on this process's clock: its monotonic clock and `epoch_offset_ns`.
        """
        for frames, received_ns in self.subscriber.receive_raw():
            if self._accepts_batches and frames[0] == BATCH_FRAME:
                yield from self._unpacked(frames, received_ns, epoch_offset_ns)
            elif not self.batched:
                if self._accepts_batches:
                    self._keep(received_ns, frames)
                yield self._in_order(received_ns), frames

    def check(self, now_ns: int) -> None:
        """Go back to single messages when there has been no batch for long, with everything that has come taken."""
        if self.batched and now_ns - self._last_batch_ns > _SILENT_NS:
            self._take_singly()

    def _unpacked(self, frames: Frames, received_ns: int, epoch_offset_ns: int) -> Iterator[tuple[int, Frames]]:
        self._last_batch_ns = received_ns
        try:
            if len(frames) != 2:
                raise WireError("frames", f"a batch has 2 frames, this one has {len(frames)}")
            batch = read_batch(frames[1])
        except WireError:
            # for whoever keeps what is no message
            yield self._in_order(received_ns), frames
            return
        known = self._take_batches() if not self.batched else ()
        for sent_ns, topic, payload in batch.sent:
            single = [topic, payload]
            if single not in known:
                time_ns = sent_ns + epoch_offset_ns
                plausible = received_ns - _LONGEST_STALL_NS <= time_ns <= received_ns
                yield self._in_order(time_ns if plausible else received_ns), single
        if batch.last:
            self._take_singly()

    def _take_batches(self) -> Sequence[Frames]:
        """Subscribe to batches only; return what came before the first one."""
        self.batched = True
        for topic in self.subscriber.topics:
            self.subscriber.socket.unsubscribe(topic.encode())
        known = [frames for _, frames in self._recent]
        self._recent.clear()
        return known

    def _keep(self, received_ns: int, frames: Frames) -> None:
        """Keep a message that the first batch may have as well."""
        while self._recent and received_ns - self._recent[0][0] > _SILENT_NS:
            self._recent.popleft()
        self._recent.append((received_ns, frames))

    def _take_singly(self) -> None:
        self.batched = False
        for topic in self.subscriber.topics:
            self.subscriber.socket.subscribe(topic.encode())

    def _in_order(self, time_ns: int) -> int:
        """Return a time that is not before that of the message before it."""
        self._last_ns = max(self._last_ns, time_ns)
        return self._last_ns

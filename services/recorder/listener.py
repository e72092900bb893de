"""A recorder's connection to one publisher: message by message, or in batches where the publisher makes them."""

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from operator import itemgetter

from proto.batch import BATCH_FRAME, read_batch
from proto.codec import WireError
from proto.sequence import SequenceTracker
from proto.topics import Topic
from services.runtime.bus.bus import Subscriber
from services.runtime.bus.outgoing_batch import LATEST_NS

# a node sends its health twice a second, and with it a batch
_SILENT_NS = 1_200_000_000
# messages that may have come before the first batch, which has them as well: no more, and none that is older than that
_MOST_RECENT = 1024
# age at which all that was sent before has come in a batch: the age of a batch, and its way
HOLD_NS = LATEST_NS + 2_000_000

# a process stands still for less; what is older was stamped by another clock
_LONGEST_STALL_NS = 3_600_000_000_000

Frames = Sequence[bytes]


@dataclass(slots=True)
class Stream:
    """What one publisher sends on one topic, received at one site.

    `live`: received at its publisher, with the stamps of this time: no queue is as long as those of a replay are old.
    `is_plain`: its messages are recorded and mean nothing to the recorder, up to this `version` and `most_bytes`.
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
    is_plain: bool
    version: int
    most_bytes: int


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
    # single messages with the time of reception [ns]: those that wait for a batch that may begin before them, and
    # Those in `_recent` were yielded lately.
    _held: list[tuple[int, Frames]] = field(default_factory=list)
    _recent: deque[tuple[int, Frames]] = field(default_factory=lambda: deque(maxlen=_MOST_RECENT))

    @property
    def accepts_batches(self) -> bool:
        """Whether this publisher's messages may come in batches."""
        return self._accepts_batches

    def accept_batches(self) -> None:
        """Ask for batches; until the first one comes, and when there are no more, the messages come one by one.

        For a publisher on this machine, whose batches have the times of its clock, and of which all is recorded.
        """
        self._accepts_batches = True
        self.subscriber.socket.subscribe(BATCH_FRAME)

    def receive(self, epoch_offset_ns: int, now_ns: int) -> Iterator[tuple[int, Frames]]:
        """Yield what has arrived, in the order of sending: time of reception [ns], frames.

        Of a batch that is the time of sending, on this process's clock: its monotonic clock and `epoch_offset_ns`.
        Where batches are accepted a single message is yielded `HOLD_NS` after its reception, because the first batch
        may have messages that were sent before it; `now_ns` is the time on the epoch [ns].
        """
        for frames, received_ns in self.subscriber.receive_raw():
            if self._accepts_batches and frames[0] == BATCH_FRAME:
                yield from self._unpacked(frames, received_ns, epoch_offset_ns)
            elif self._accepts_batches and not self.batched:
                self._held.append((received_ns, frames))
            elif not self.batched:
                yield self._in_order(received_ns), frames
        yield from self._release(now_ns - HOLD_NS)

    def check(self, now_ns: int) -> None:
        """Go back to single messages when there has been no batch for long, with everything that has come taken."""
        if self.batched and now_ns - self._last_batch_ns > _SILENT_NS:
            self._take_singly()

    def _release(self, until_ns: int) -> Iterator[tuple[int, Frames]]:
        """Yield the single messages that have waited for long enough."""
        count = bisect_right(self._held, until_ns, key=itemgetter(0))
        for received_ns, frames in self._held[:count]:
            self._keep(received_ns, frames)
            yield self._in_order(received_ns), frames
        del self._held[:count]

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
        copies: list[tuple[int, Frames]] = [
            (self._sent_ns(sent_ns + epoch_offset_ns, received_ns), [topic, payload])
            for sent_ns, topic, payload in batch.sent
        ]
        if not self.batched:
            copies = self._take_batches(copies)
        for time_ns, single in copies:
            yield self._in_order(time_ns), single
        if batch.last:
            self._take_singly()

    @staticmethod
    def _sent_ns(time_ns: int, received_ns: int) -> int:
        """Return the time of sending, or that of reception where the other one is of another clock."""
        return time_ns if received_ns - _LONGEST_STALL_NS <= time_ns <= received_ns else received_ns

    def _take_batches(self, copies: Sequence[tuple[int, Frames]]) -> list[tuple[int, Frames]]:
        """Subscribe to batches only; return what is to be yielded with the first one, in the order of sending.

        A single message that is not in the batch was sent before it.
        """
        self.batched = True
        for topic in self.subscriber.topics:
            self.subscriber.socket.unsubscribe(topic.encode())
        batch = {tuple(frames) for _, frames in copies}
        yielded = {tuple(frames) for _, frames in self._recent}
        first_ns = copies[0][0] if copies else 0
        before = [
            (min(received_ns, first_ns) if copies else received_ns, frames)
            for received_ns, frames in self._held
            if tuple(frames) not in batch
        ]
        self._recent.clear()
        self._held.clear()
        return [*before, *(copy for copy in copies if tuple(copy[1]) not in yielded)]

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

"""A reader of messages that are passed in memory: it checks, counts and reports them as those of a socket.

The bus of a session in virtual time uses it, and so do the nodes of a site that run in one process.
"""

from collections.abc import Iterable, Sequence

from telenano.runtime.bus.bus import MessageReader, Taken
from telenano.timing.clock import Clock
from telenano.wire import TOPICS, Message
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival

# Bound to names, because they are used for every message and the lookup of an enumeration member takes longer.
_NEXT = Arrival.NEXT
_DUPLICATE = Arrival.DUPLICATE
_LATE = Arrival.LATE

# Time of arrival [ns], number, topic, bytes and decoded message; None instead of the message if the bytes are invalid.
Arriving = tuple[int, int, str, bytes, Message | None]


class HandedReader(MessageReader):
    """A reader of messages that are passed in decoded form, so that their bytes are not decoded again."""

    def __init__(self, clock: Clock, topics: Iterable[str], *, newest_only: bool = False) -> None:
        super().__init__(clock, topics, newest_only=newest_only)
        self.prefixes: tuple[str, ...] = ()
        self._known: dict[bytes, Message | None] = {}

    @property
    def socket(self) -> "HandedReader":
        """The object with the method `subscribe`, as other readers have a socket: this reader itself."""
        return self

    def subscribe(self, prefix: bytes) -> None:
        """Also read the topics that begin with a prefix."""
        self.prefixes = (*self.prefixes, prefix.decode())

    def wants(self, topic: str) -> bool:
        """Return whether a topic is subscribed to."""
        return topic in self.topics or any(map(topic.startswith, self.prefixes))

    def arrived(self, waiting: Sequence[Arriving], received_ns: int) -> list[Received]:
        """Return the messages of a batch that are accepted by the same checks as those of a socket."""
        if len(waiting) == 1:
            # A batch has most often one message.
            _, _, topic, payload, message = waiting[0]
            received = self._track(topic, payload, message, received_ns)
            return [] if received is None else [received]
        self._known = {payload: message for _, _, _, payload, message in waiting}
        frames: list[Taken] = [((topic.encode(), payload), received_ns) for _, _, topic, payload, _ in waiting]
        return self.take(frames)

    def decode_and_track(self, frames: Sequence[bytes], received_ns: int) -> Received | None:
        return self._track(frames[0].decode(), frames[1], self._known.get(frames[1]), received_ns)

    def _track(self, topic: str, payload: bytes, message: Message | None, received_ns: int) -> Received | None:
        if message is None:
            # An invalid message is refused and counted with the same reasons as on a socket.
            return super().decode_and_track((topic.encode(), payload), received_ns)
        tracker = self.trackers.get((topic, message.src)) or self.tracker(topic, message.src)
        arrival = tracker.accept(message.seq, message.t_ns, message.run)
        if arrival is not _NEXT and (
            (arrival is _LATE and TOPICS[topic].delivery == "latest")
            or (arrival is _DUPLICATE and topic != "session/control")
        ):
            return None
        return Received(topic, message, payload, received_ns, arrival)

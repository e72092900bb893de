"""The bus of the nodes of one process: each message is sent by socket as usual, and passed in memory to the others."""

from collections import defaultdict, deque
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from typing import Any, cast

from telenano.runtime.bus.bus import Reader, Subscriber, ZmqBus
from telenano.runtime.bus.handed_reader import Arriving, HandedReader
from telenano.runtime.bus.publisher import Publisher, ZmqPublisher, version_of
from telenano.timing.clock import NEVER_NS, Clock
from telenano.wire import Message, compose
from telenano.wire.received import Received

# Number of messages received by sockets whose decoded form is cached by their bytes.
_MOST_KNOWN = 256
# Called with endpoint, topic and bytes of a message that was just sent, and its decoded form, None if unknown.
HandOver = Callable[[str, str, bytes, Message | None], None]


class NearReader(HandedReader):
    """The reader of a node for messages from nodes of the same process, each with its bytes as sent."""

    def __init__(self, clock: Clock, topics: Iterable[str], *, newest_only: bool) -> None:
        super().__init__(clock, topics, newest_only=newest_only)
        self.inbox: list[Arriving] = []

    def receive(self) -> list[Received]:
        """Return the messages since the last call that are accepted by the same checks as those of a socket."""
        waiting, self.inbox = self.inbox, []
        return self.arrived(waiting, self._clock.now_ns()) if waiting else []


class SitePublisher(ZmqPublisher):
    """A PUB socket that also passes each message, after sending it, to the other nodes of its process."""

    hand_over: HandOver

    def publish(self, topic: str, **fields: Any) -> Message:
        seq = self._sequence.get(topic, 0)
        header = {"seq": seq, "t_ns": self._clock.now_ns(), "src": self.node, "v": version_of(topic), "run": self._run}
        # The message is encoded before it is passed on: readers need its bytes, and an invalid message reaches none.
        message, payload = compose(topic, {**header, **fields}, self.on_limited)
        super().send(topic, payload)
        self._sequence[topic] = seq + 1
        self.hand_over(self.node, topic, payload, message)
        return message

    def send(self, topic: str, payload: bytes) -> None:
        super().send(topic, payload)
        self.hand_over(self.node, topic, payload, None)


class Exchange:
    """The routes of messages in memory between the nodes of a process, and the queue of nodes with waiting messages.

    Args:
        endpoints: The endpoints of the process; the link has one at each site.
        forwards: The node that forwards received messages unchanged, the link; empty without it.
    """

    def __init__(self, endpoints: Container[str], forwards: str = "") -> None:
        self.endpoints = endpoints
        # The nodes with waiting messages, in the order in which the first message for each was sent.
        self.pending: deque[str] = deque()
        self._forwards = forwards
        # The publishers of the process. They need not yield the processor after each message, because turns for
        # messages in memory come first, and the process waits soon after.
        self.publishers: list[SitePublisher] = []
        self._routes: dict[tuple[str, str], list[tuple[str, NearReader]]] = defaultdict(list)
        self._known: dict[bytes, Message] = {}

    def connect(self, key: str, reader: NearReader, plan: Mapping[str, Sequence[str]]) -> None:
        """Connect a reader of node `key` to endpoints (keys) for topics (values)."""
        for endpoint, topics in plan.items():
            for topic in topics:
                self._routes[endpoint, topic].append((key, reader))

    def hand_over(self, endpoint: str, topic: str, payload: bytes, message: Message | None) -> None:
        """Queue a message that was just sent for its readers in this process."""
        routes = self._routes.get((endpoint, topic))
        if not routes:
            return
        if message is None:
            message = self._known.get(payload)
        for key, reader in routes:
            if not reader.inbox:
                self.pending.append(key)
            reader.inbox.append((0, 0, topic, payload, message))

    def note_received(self, key: str, received: Sequence[Received]) -> None:
        """Cache the decoded form of messages that the forwarding node has received, because it may send their bytes."""
        if key == self._forwards:
            if len(self._known) > _MOST_KNOWN:
                self._known.clear()
            for one in received:
                self._known[one.payload] = one.message


class SiteBus(ZmqBus):
    """The bus of one of several nodes of a process; the process waits for all of them together."""

    def __init__(
        self,
        publisher: Publisher,
        readers: Sequence[Reader],
        clock: Clock,
        wake_descriptor: int,
        note_received: Callable[[Sequence[Received]], None],
    ) -> None:
        self.near = [reader for reader in readers if isinstance(reader, NearReader)]
        self.sockets = [reader for reader in readers if not isinstance(reader, NearReader)]
        super().__init__(publisher, self.sockets, clock, wake_descriptor)
        for reader in self.near:
            # The reader is counted and reported like the others, but has no socket to wait for.
            self.subscribers.insert(0, cast(Subscriber, reader))
            self.count(reader)
        # The descriptors of the sockets that the next `receive` has to read.
        self.asked: set[int] = set()
        self._note_received = note_received
        self.has_arrived_anywhere: Callable[[], bool] = lambda: False

    @property
    def descriptors(self) -> list[int]:
        """The descriptors that become readable when messages or network events of this node arrive."""
        return [*(reader.descriptor for reader in self.sockets), *self._network_descriptors]

    @property
    def due_ns(self) -> int:
        """Time at which messages are due without a readable descriptor, on the monotonic clock [ns]."""
        return NEVER_NS if self._timed is None else self._timed.due_ns

    def wait(self, deadline_ns: int) -> None:
        """Return at once: the loop of the process has waited for all nodes."""

    def wake(self, descriptor: int) -> None:
        """Mark a readable descriptor: the next `receive` reads its socket, or network events are processed."""
        self._events_pending |= descriptor in self._network_descriptors
        self.asked.add(descriptor)

    def receive(self) -> Iterable[Received]:
        received: list[Received] = []
        for near in self.near:
            if near.inbox:
                received += near.receive()
        asked, self.asked = self.asked, set()
        timed = self._timed
        for reader in self.sockets:
            if reader.descriptor in asked:
                received += reader.receive(signalled=reader.drained)
            elif reader.shared or (reader is timed and reader.due_ns <= self._clock.monotonic_ns()):
                received += reader.receive()
        if received:
            self._note_received(received)
        return received

    def has_arrived(self) -> bool:
        return self.has_arrived_anywhere()

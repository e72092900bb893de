"""How the nodes of one process hear each other: what one publishes is sent as ever, and handed over in memory."""

from collections import defaultdict, deque
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from typing import Any, cast

from telenano.runtime.bus.bus import Reader, Subscriber, ZmqBus
from telenano.runtime.bus.handed_reader import Arriving, HandedReader
from telenano.runtime.bus.publisher import Publisher, ZmqPublisher, version_of
from telenano.timing.clock import NEVER_NS, Clock
from telenano.wire import Message, compose
from telenano.wire.received import Received

# Of so many messages that sockets have brought the decoded form is at hand, beside their bytes.
_MOST_KNOWN = 256
# Takes an endpoint, topic and bytes of a message that was just sent there, and what they say where that is known.
HandOver = Callable[[str, str, bytes, Message | None], None]


class NearReader(HandedReader):
    """What a node receives from nodes of its own process: each message with its bytes, as it was sent."""

    def __init__(self, clock: Clock, topics: Iterable[str], *, newest_only: bool) -> None:
        super().__init__(clock, topics, newest_only=newest_only)
        self.inbox: list[Arriving] = []

    def receive(self) -> list[Received]:
        """Return the messages that have come since the last call, judged as those of a socket are."""
        waiting, self.inbox = self.inbox, []
        return self.arrived(waiting, self._clock.now_ns()) if waiting else []


class SitePublisher(ZmqPublisher):
    """A PUB socket that hands each message on to the nodes of its process, once it was sent."""

    hand_over: HandOver

    def publish(self, topic: str, **fields: Any) -> Message:
        seq = self._sequence.get(topic, 0)
        header = {"seq": seq, "t_ns": self._clock.now_ns(), "src": self.node, "v": version_of(topic)}
        # It is encoded before it is handed over: the journal of a reader has the size, and a wrong one goes nowhere.
        message, payload = compose(topic, {**header, **fields}, self.on_limited)
        super().send(topic, payload)
        self._sequence[topic] = seq + 1
        self.hand_over(self.node, topic, payload, message)
        return message

    def send(self, topic: str, payload: bytes) -> None:
        super().send(topic, payload)
        self.hand_over(self.node, topic, payload, None)


class Exchange:
    """Who of a process reads what of whom, and the messages that wait for their readers.

    Args:
        endpoints: The endpoints of the process; the link has one at each site.
        forwards: The node that sends on what it has received as it came, the link; empty without it.
    """

    def __init__(self, endpoints: Container[str], forwards: str = "") -> None:
        self.endpoints = endpoints
        # The nodes for which messages wait, in the order in which the first one of each was sent.
        self.pending: deque[str] = deque()
        self._forwards = forwards
        # What sends to other processes: turns that memory brings come first, and the process waits soon after.
        self.publishers: list[SitePublisher] = []
        self._routes: dict[tuple[str, str], list[tuple[str, NearReader]]] = defaultdict(list)
        self._known: dict[bytes, Message] = {}

    def connect(self, key: str, reader: NearReader, plan: Mapping[str, Sequence[str]]) -> None:
        """Have a reader of a node receive topics (values) of endpoints (keys)."""
        for endpoint, topics in plan.items():
            for topic in topics:
                self._routes[endpoint, topic].append((key, reader))

    def hand_over(self, endpoint: str, topic: str, payload: bytes, message: Message | None) -> None:
        """Bring a message that was just sent to the readers of its endpoint in this process."""
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
        """Note what a node has received, which it may send on as it came."""
        if key == self._forwards:
            if len(self._known) > _MOST_KNOWN:
                self._known.clear()
            for one in received:
                self._known[one.payload] = one.message


class SiteBus(ZmqBus):
    """The bus of one of several nodes of a process, which waits for all of them."""

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
            # It is counted and reported as the others are, and has no socket to wait for.
            self.subscribers.insert(0, cast(Subscriber, reader))
            self.count(reader)
        # The sockets that are to be asked at the next `receive`, by their descriptors.
        self.asked: set[int] = set()
        self._note_received = note_received
        self.has_arrived_anywhere: Callable[[], bool] = lambda: False

    @property
    def descriptors(self) -> list[int]:
        """What becomes readable when this node has something to take."""
        return [*(reader.descriptor for reader in self.sockets), *self._network_descriptors]

    @property
    def due_ns(self) -> int:
        """When something is to be taken without a readable descriptor, on the monotonic clock [ns]."""
        return NEVER_NS if self._timed is None else self._timed.due_ns

    def wait(self, deadline_ns: int) -> None:
        """Return at once: the process has waited."""

    def wake(self, descriptor: int) -> None:
        """Have a socket asked at the next `receive`, or the network looked after."""
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

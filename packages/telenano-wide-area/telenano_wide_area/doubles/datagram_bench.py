"""Two ends of the link's datagrams in one process for tests: real sockets, virtual clocks, keys passed by hand."""

import select
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import zmq

from telenano.runtime import ConnectionEvent, Subscriber
from telenano.testing import VirtualClock, payload
from telenano.wire import Message, Received, compose
from telenano_wide_area.datagram.end import DatagramEnd
from telenano_wide_area.datagram.place import Place
from telenano_wide_area.datagram.sparse import SPARSE
from telenano_wide_area.settings import DatagramSettings

STEP_NS = 10_000_000
SOURCES = {"teleop/forward": "controller@master", "teleop/backward": "controller@slave"}


class Outlet:
    """Collects the messages that an end publishes, checked as on the wire."""

    def __init__(self, src: str) -> None:
        self.src = src
        self.sent: list[tuple[str, Message]] = []

    def publish(self, topic: str, **fields: Any) -> Message:
        header = {"seq": len(self.sent), "t_ns": 0, "src": self.src, "v": 1}
        message, _ = compose(topic, {**header, **fields})
        self.sent.append((topic, message))
        return message

    def last(self, topic: str) -> Any:
        return [message for name, message in self.sent if name == topic][-1]


class SocketLog:
    """A stand-in for the SUB socket that logs which topics are subscribed over TCP."""

    def __init__(self, topics: list[str]) -> None:
        self.topics = set(topics)

    def subscribe(self, topic: bytes) -> None:
        self.topics.add(topic.decode())

    @property
    def whole(self) -> set[str]:
        """The topics that are subscribed as a whole, not only by their sparse samples."""
        return {topic for topic in self.topics if not topic.encode().startswith(SPARSE)}

    def unsubscribe(self, topic: bytes) -> None:
        self.topics.discard(topic.decode())


class Side:
    """The process of one end, with the messages that it received and reported."""

    def __init__(
        self, context: Any, *, is_master: bool, master_port: int, host: str, ahead_ns: int, **link: Any
    ) -> None:
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=10**18 + ahead_ns)
        self.incoming = "teleop/backward" if is_master else "teleop/forward"
        self.outgoing = "teleop/forward" if is_master else "teleop/backward"
        topics = [self.incoming, *(["law/status"] if is_master else [])]
        self.subscriber = Subscriber(context, self.clock, {"inproc://nowhere": topics}, connect=False)
        self.real_socket = self.subscriber.socket
        self.log = SocketLog(topics)
        self.subscriber.socket = self.log  # type: ignore[assignment]
        self.outlet = Outlet("delay_node@slave" if is_master else "controller@slave")
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        place = Place(
            family, (host, master_port if is_master else 0), None if is_master else (host, master_port), master_port
        )
        self.is_allowed = self.is_connected = True
        self.received: list[Received] = []
        self.seq = 0
        self.events: list[Any] = []
        self.is_master, self.machine, self.reader = is_master, "slave" if is_master else "master", self.subscriber
        self.publish = self.report = self.outlet.publish
        self.end = DatagramEnd(self, place, DatagramSettings(**link))  # type: ignore[arg-type]

    def tell(self, level: str, text: str, data: Any) -> None:
        self.events.append(ConnectionEvent(level, text, data))

    @property
    def port(self) -> int:
        return int(self.end.socket.getsockname()[1])

    def send(self) -> bytes:
        """Send the next sample."""
        made = payload(self.outgoing, SOURCES[self.outgoing], self.seq)
        self.seq += 1
        self.end.carry(self.outgoing, made)
        return made

    def take(self) -> None:
        """Receive what has arrived, as a turn of the loop does."""
        readable = bool(select.select([self.end.descriptor], [], [], 0)[0])
        self.received += self.end.receive(signalled=readable)

    def hears_key_of(self, other: "Side") -> None:
        keys = [message for topic, message in other.outlet.sent if topic == "link/key"]
        if keys and self.is_allowed:
            self.end._hear_offer(keys[-1])

    @property
    def seqs(self) -> list[int]:
        return [received.message.seq for received in self.received if received.topic == self.incoming]


class Pair:
    """Both ends; datagrams cross the loopback interface, and keys are passed by hand, as CURVE would carry them."""

    def __init__(self, context: Any, host: str = "127.0.0.1", ahead_ns: int = 0, **link: Any) -> None:
        with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind((host, 0))
            port = probe.getsockname()[1]
        common = {"master_port": port, "host": host, **link}
        self.master = Side(context, is_master=True, ahead_ns=0, **common)
        self.slave = Side(context, is_master=False, ahead_ns=ahead_ns, **common)
        self.keys_cross = True

    @property
    def sides(self) -> tuple[Side, Side]:
        return self.master, self.slave

    def turn(self, *, send: bool = True) -> None:
        """Advance by 10 ms: keys cross, both ends send a sample, both receive what has arrived."""
        for side in self.sides:
            side.clock.advance_ns(STEP_NS)
        if self.keys_cross:
            self.slave.hears_key_of(self.master)
            self.master.hears_key_of(self.slave)
        for side in self.sides:
            if send:
                side.send()
        for side in self.sides:
            side.take()

    def turns(self, count: int) -> None:
        for _ in range(count):
            self.turn()

    def joined(self) -> "Pair":
        """Advance until both ends receive datagrams."""
        self.turns(100)
        assert [side.end.receiving for side in self.sides] == ["datagram", "datagram"]
        return self

    def close(self) -> None:
        for side in self.sides:
            side.end.close()
            side.real_socket.close()


@contextmanager
def pair(host: str = "127.0.0.1", ahead_ns: int = 0, **link: Any) -> Iterator[Pair]:
    """Yield two ends and close them afterwards."""
    context: Any = zmq.Context()
    made = Pair(context, host, ahead_ns, **link)
    try:
        yield made
    finally:
        made.close()
        context.term()

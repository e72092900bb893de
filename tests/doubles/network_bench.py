"""Machines of a rig within one process: each has a context, a folder of keys and a clock; real sockets connect them."""

import select
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import ConnectionEvent, Subscriber
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.security.keyring import Keyring, Role
from telenano.runtime.wiring.transport import Transport, open_context
from telenano.testing import VirtualClock, free_ports, payload
from telenano.wire.received import Received

PATIENCE_S = 30.0
TURN_NS = 20_000_000
AFM, CONTROLLER, LINK = "afm_node@slave", "controller@slave", "delay_node@slave"
BOTH: tuple[Role, ...] = ("data", "control")
# Topic that each node publishes in every turn.
TOPIC_OF = {AFM: "afm/state", CONTROLLER: "teleop/backward", LINK: "teleop/forward"}
SOURCE_OF = {LINK: "controller@master"}


def two_machine_book(folder: Path, **more: Any) -> AddressBook:
    """Return the address book of three nodes that publish over a network: the link at the master, two at the slave."""
    hosts = {AFM: "slave", CONTROLLER: "slave", LINK: "master"}
    nodes = {
        node: {"local": f"ipc://{folder}/{node}", "network": f"tcp://{{{host}}}:{port}"}
        for (node, host), port in zip(hosts.items(), free_ports(len(hosts)), strict=True)
    }
    document = {"machines": {"master": "127.0.0.1", "slave": "127.0.0.1"}, "nodes": nodes, **more}
    return AddressBook.model_validate(document)


def port_of(book: AddressBook, node: str) -> int:
    """Return the network port of a node."""
    return int((book.network_endpoint(node) or "").rpartition(":")[2])


class Machine:
    """One machine, whose clock advances by 20 ms a turn."""

    def __init__(self, name: str, book: AddressBook, folder: Path) -> None:
        self.name = name
        self.book = book
        self.ring = Keyring(folder / name)
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=10**18)
        self.events: list[ConnectionEvent] = []
        self.received: list[Received] = []
        self.publishers: dict[str, ZmqPublisher] = {}
        self.subscribers: list[Subscriber] = []
        self.sent = 0
        if book.requires_keys:
            self.ring.create(name)

    @property
    def key(self) -> str:
        return self.ring.own(self.name).public.decode()

    def knows(self, other: "Machine", roles: Sequence[Role] = BOTH) -> None:
        """Allow the key of another machine."""
        self.ring.allow(other.name, other.key, roles)

    def open(self) -> "Machine":
        self.context = open_context(serves_network=True)
        self.network = Transport(self.context, self.clock, self.book, self.name, self.ring)
        return self

    def bind(self, *nodes: str) -> "Machine":
        self.publishers |= {node: self.network.publisher(node) for node in nodes}
        return self

    def subscribe(self, sources: Mapping[str, Sequence[str]] | None = None, *, apart: bool = False) -> "Machine":
        plan = sources or {AFM: ["afm/state"], CONTROLLER: ["teleop/backward"]}
        self.subscribers += self.network.subscribers(plan, apart=apart)
        return self

    def turn(self) -> None:
        """Publish one message at each publisher, and process connection events and received messages."""
        self.clock.advance_ns(TURN_NS)
        for node, publisher in self.publishers.items():
            topic = TOPIC_OF.get(node, "session/event")
            publisher.send(topic, payload(topic, SOURCE_OF.get(node, node), self.sent))
        self.sent += 1
        self.events += self.network.process_events()
        for subscriber in self.subscribers:
            self.received += subscriber.receive()

    def received_from(self, src: str) -> int:
        """Return the number of messages received from a source."""
        return sum(received.message.src == src for received in self.received)

    @property
    def changes(self) -> list[ConnectionEvent]:
        """The events of connections, without the reminders of missing ones.

        The clock advances faster than real time, so a reminder may come before a connection.
        """
        return [event for event in self.events if event.data.get("connection") != "unreached"]

    def texts(self, connection: str, peer: str | None = None) -> list[str]:
        """Return the texts of one kind of connection events, of all peers or one."""
        return [
            n.text for n in self.events if n.data.get("connection") == connection and peer in (None, n.data.get("peer"))
        ]

    def close(self) -> None:
        """Close everything, like a node."""
        for each in (*self.subscribers, *self.publishers.values()):
            each.close()
        self.subscribers.clear()
        self.publishers.clear()
        self.network.close()
        self.context.term()


def turns(count: int, *machines: Machine) -> None:
    """Let machines run for a number of turns, at least 1 ms each."""
    for _ in range(count):
        for machine in machines:
            machine.turn()
        _pause(machines)


def until(condition: Callable[[], object], *machines: Machine) -> None:
    """Let machines run until a condition holds."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, [
            (machine.name, machine.events, machine.network.rejected) for machine in machines
        ]
        for machine in machines:
            machine.turn()
        _pause(machines)


def receives_more(machine: Machine, src: str, count: int = 5) -> Callable[[], bool]:
    """Return the condition that a machine receives `count` more messages from a source."""
    before = machine.received_from(src)
    return lambda: machine.received_from(src) >= before + count


def _pause(machines: Sequence[Machine]) -> None:
    descriptors = [descriptor for machine in machines for descriptor in machine.network.descriptors]
    descriptors += [subscriber.descriptor for machine in machines for subscriber in machine.subscribers]
    select.select(descriptors, (), (), 0.001)

"""The part of a process in the bus: the sockets that it opens, the loop that it runs, and the end of both."""

import contextlib
import itertools
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any, ClassVar

import zmq

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import Bus, Reader, Subscriber, ZmqBus
from telenano.runtime.bus.holders import STOP_SIGNAL
from telenano.runtime.bus.publisher import Publisher, ZmqPublisher, publish_end
from telenano.runtime.bus.transports import STREAM
from telenano.runtime.loop.commands import Command, CommandClient
from telenano.runtime.loop.hang_guard import HangGuard
from telenano.runtime.loop.log import RateLimitedLog, StructuredLog
from telenano.runtime.loop.machine import OWN_MACHINE, Machine
from telenano.runtime.loop.node import LOOP_PERIOD_S, Node, NodeBus, NodeContext
from telenano.runtime.loop.node_loop import STARTING_PERIOD_NS, NodeLoop, install_stop_signals
from telenano.runtime.loop.realtime import RealtimeStatus, freeze_garbage, ordinary_scheduling, raise_file_limit
from telenano.runtime.security.keyring import MACHINE_VARIABLE, Keyring, this_machine
from telenano.runtime.wiring.link_transports import LinkEnds, LinkSide, link_transport
from telenano.runtime.wiring.transport import Transport, open_context
from telenano.settings.package_topics import topics_by_name
from telenano.timing.clock import Clock, SystemClock
from telenano.wire.errors import ConfigError, EndpointError
from telenano.wire.nodes import DEVICES, FAR_END, KEEPERS, Site, is_console, site_of

SITES = ("master", "slave")
# A participant that only listens has this name, which is in no site file.
OBSERVER = "record@master"
NO_REALTIME = RealtimeStatus(fifo=False, memory_locked=False)


@dataclass(frozen=True)
class NoNetwork:
    """The network of a node without sockets: only the name of its machine."""

    machine: str
    descriptors: Sequence[int] = ()
    # Without sockets there are no paths that could be removed, and no connections that could fail.
    places: None = None
    hearing: None = None


@dataclass(frozen=True, kw_only=True)
class Participant:
    """A process on the bus: its name there, its clock, and the sockets that it opens.

    `wake_descriptor` becomes readable at a stop signal, to end the wait of a bus; `period_s` is the period of the loop
    [s].
    """

    # The class that sends the messages of a node.
    publisher_class: ClassVar[type[ZmqPublisher]] = ZmqPublisher
    key: str
    book: AddressBook
    clock: Clock
    log: StructuredLog
    network: Transport
    wake_descriptor: int
    period_s: float = LOOP_PERIOD_S
    machine: Machine = OWN_MACHINE
    # Further metadata, by name, for a recording that this process begins.
    recorded_facts: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    resources: contextlib.ExitStack = field(default_factory=contextlib.ExitStack)

    def bind(self, key: str, kind: int = zmq.PUB, *, ends: bool = False) -> ZmqPublisher:
        """Bind the endpoints of a node, and return its publisher, which is closed with this participant.

        Args:
            key: The node as node@site.
            kind: The kind of the ZeroMQ socket.
            ends: Whether closing this participant publishes the last message of the node, the number of messages that
                it has sent. A node with a loop publishes that itself.

        Raises:
            EndpointError: The endpoints cannot be bound; the message has the reason.
        """
        opened = self.network.publisher(key, kind, self.publisher_class)
        publisher = self.resources.enter_context(contextlib.closing(opened))
        log = RateLimitedLog(self.log, self.clock)
        publisher.on_limited = lambda text: log.warning("range", text)
        if ends:
            self.resources.callback(publish_end, publisher, key)
        return publisher

    def subscribers(
        self,
        connections: Mapping[str, Sequence[str]],
        *,
        apart: bool = False,
        newest_only: bool = False,
        shared: bool = False,
    ) -> list[Subscriber]:
        """Connect to nodes (keys) for topics (values): a socket for each machine, or with `apart` for each node.

        The other arguments are those of `Transport.subscribers`.
        """
        opened = self.network.subscribers(connections, apart=apart, newest_only=newest_only, shared=shared)
        return [self.resources.enter_context(contextlib.closing(subscriber)) for subscriber in opened]

    def observe(
        self, wanted: Callable[[str, str], bool], sites: Sequence[str] = SITES, *, shared: bool = False
    ) -> dict[str, Subscriber]:
        """Connect to each node at `sites` by its own socket, and return the subscribers by node.

        Topics of installed packages that this process does not know yet are subscribed to at each of these nodes.

        Args:
            wanted: Returns whether to subscribe to a topic at a node.
            sites: The sites of the nodes.
            shared: Whether to connect to the process that reads a node once for all observers, if there is one.
        """
        topics_of = self.book.observed(self.network.machine, sites)
        plan = {node: [topic for topic in topics if wanted(topic, node)] for node, topics in topics_of.items()}
        plan = {node: topics for node, topics in plan.items() if topics}
        subscriber_of = dict(zip(plan, self.subscribers(plan, apart=True, shared=shared), strict=True))
        for node, topic in itertools.product(subscriber_of, topics_by_name()):
            if wanted(topic, node):
                subscriber_of[node].socket.subscribe(topic.encode())
        return subscriber_of

    def bus(self, topics: Sequence[str], *, newest_only: bool = False) -> ZmqBus:
        """Open the bus of an ordinary node: its endpoint, the connections for its inputs, and an inlet for stops.

        Args:
            topics: The topics that the node reads.
            newest_only: True for a node of the loop, which acts on the newest message of each `latest` topic.
        """
        # The publisher is opened first: if that fails, nothing else is open yet.
        publisher = self.bind(self.key)
        subscribers = self.subscribers(self.book.sources(self.key, topics), newest_only=newest_only)
        ends = self.link_ends(publisher, publisher, subscribers) if self.key == FAR_END else LinkEnds()
        return self.bus_of(
            publisher, [*subscribers, *ends.readers, *(self.estop_inlet() if self.key in DEVICES else ())]
        )

    def link_ends(self, outgoing: ZmqPublisher, reports: ZmqPublisher, readers: Sequence[Subscriber]) -> LinkEnds:
        """Open this end of the link's transport, and return its parts.

        The parts are empty, and TCP carries everything, in a rig on one machine, if the site file requests TCP, or if
        the end cannot be opened, which is logged.

        Args:
            outgoing: The publisher of messages for the other machine.
            reports: The publisher of the status of the network.
            readers: The readers of this node, one of which receives from the other machine.
        """
        name = self.book.link.transport
        if not self.book.spans_machines or name == STREAM:
            return LinkEnds()
        try:
            transport = link_transport(name)
            side = LinkSide.of(self.key, self.network, outgoing, reports, readers)
            if side is None:
                return LinkEnds()
            # A transport imports its libraries in this call, so only the two processes at the ends load them.
            transport.open_end(side)
        except (OSError, ValueError, ConfigError) as error:
            self.log.warning(f"the link sends no datagrams: {error}; everything crosses over TCP")
            return LinkEnds()
        outgoing.carry = side.ends.carry
        return side.ends

    def estop_inlet(self) -> list[Subscriber]:
        """Open the inlet for emergency stops; empty without an ipc endpoint, where only a console can send stops."""
        inlet = self.network.estop_inlet(self.key)
        return [] if inlet is None else [self.resources.enter_context(contextlib.closing(inlet))]

    def bus_of(self, publisher: Publisher, subscribers: Sequence[Reader]) -> ZmqBus:
        """Return the bus of a publisher and readers that were opened before."""
        bus = ZmqBus(publisher, subscribers, self.clock, self.wake_descriptor, self.network)
        bus.is_brief = is_brief(self.book, self.key)
        return bus

    def recording_bus(self, make: Callable[..., Any], publisher: Publisher, listeners: Any, intake: Any) -> Any:
        """Return the bus of a recorder, which passes the messages of its listeners to `intake` unchanged.

        Args:
            make: The class of the bus, `RecorderBus` of the recorder.
            publisher: Sends the messages of the recorder.
            listeners: The connections of the recorder, each with the state of its streams.
            intake: Records the messages.
        """
        return make(publisher, listeners, intake, self.clock, self.wake_descriptor, self.network)

    def context(self, bus: Bus) -> NodeContext:
        return NodeContext(
            self.key,
            self.clock,
            bus,
            self.log,
            kept_stop=self.kept_stop(),
            places=self.network.places,
            hearing=self.network.hearing,
            period_s=self.period_s,
            machine=self.machine,
        )

    def kept_stop(self) -> Path | None:
        """Return the file that keeps emergency stops; None for other nodes, and without an ipc endpoint for stops.

        Devices keep their own stops, and the link keeps those of the far device.
        """
        return self.book.kept_stop(self.key) if self.key in KEEPERS else None

    @classmethod
    @contextlib.contextmanager
    def open(
        cls, key: str, book: AddressBook, wake_descriptor: int = -1, *, publisher: bool = True
    ) -> "Iterator[Participant]":
        """Take part in the bus while the block runs; then close connections, endpoints and context, in this order.

        Args:
            key: The participant as node@site.
            book: The addresses of the rig.
            wake_descriptor: The descriptor that wakes the loop.
            publisher: False for a participant without an endpoint in the site file, which may be on any machine.

        Raises:
            EndpointError: The node is not in the book.
            ConfigError: The participant's machine lacks a key that the rig requires.
        """
        raise_file_limit()
        clock = SystemClock()
        machine = _machine_of(book, key) if publisher else this_machine(Keyring())
        with contextlib.ExitStack() as resources:
            context = resources.enter_context(open_context(serves_network=publisher and book.spans_machines))
            network = resources.enter_context(
                contextlib.closing(Transport(context, clock, book, machine, owner=key if publisher else "this command"))
            )
            yield Participant(
                key=key,
                book=book,
                clock=clock,
                log=StructuredLog(key),
                network=network,
                wake_descriptor=wake_descriptor,
                resources=resources,
            )

    @classmethod
    @contextlib.contextmanager
    def at_console(cls, book: AddressBook, site: Site) -> "Iterator[Participant]":
        """Open the first console of a site that is on this machine, as `open` does.

        Raises:
            ConfigError: The site has no console on this machine.
        """
        consoles = sorted(node for node in book.nodes if is_console(node) and site_of(node) == site)
        machines = _machines_here(book)
        here = [node for node in consoles if machines is None or book.machine_of(node) in machines]
        if not here:
            elsewhere = f", {', '.join(consoles)} is on another machine" if consoles else ""
            raise ConfigError(
                f"nodes: a console@{site} of this machine is missing, commands need an endpoint{elsewhere}"
            )
        with cls.open(here[0], book) as participant:
            yield participant

    def command_client(
        self,
        commands: Sequence[Command],
        publish: Callable[..., Any],
        *,
        retry_ns: int = 0,
        issued_ns: int | None = None,
    ) -> CommandClient:
        """Return a client that sends commands one after the other and collects their answers.

        Args:
            commands: The commands.
            publish: Publishes a session/control.
            retry_ns: Time for which a required command is tried again after a refusal [ns].
            issued_ns: Time at which the commands were issued, on the monotonic clock [ns]; None for now.
        """
        return CommandClient(self.clock, publish, commands, retry_ns=retry_ns, issued_ns=issued_ns)

    @classmethod
    def observing(
        cls, book: AddressBook, wake_descriptor: int = -1
    ) -> contextlib.AbstractContextManager["Participant"]:
        """Open a participant without an endpoint of its own in the site file, such as an observer, on any machine."""
        return cls.open(OBSERVER, book, wake_descriptor, publisher=False)


def is_brief(book: AddressBook, key: str) -> bool:
    """Return whether the health of a node crosses to another machine, so that it has to be short."""
    return book.spans_machines and site_of(key) == "slave"


def _machines_here(book: AddressBook) -> list[str] | None:
    """Return the machines whose keys this process has; None for all machines, in a rig without keys."""
    if not book.requires_keys:
        return None
    keyring = Keyring()
    return [this_machine(keyring)] if MACHINE_VARIABLE in os.environ else keyring.names()


def _machine_of(book: AddressBook, key: str) -> str:
    try:
        return book.machine_of(key)
    except KeyError as error:
        raise EndpointError(str(error.args[0])) from error


class StopSignals:
    """Handles SIGTERM and SIGINT from now on: they interrupt the nodes, even if they come before the nodes exist."""

    def __init__(self) -> None:
        self._nodes: tuple[Node, ...] = ()
        self._received = False
        self.descriptor = install_stop_signals(self._receive)

    def interrupt(self, *nodes: Node) -> None:
        """Interrupt these nodes at every signal from now on, and at once if a signal has already come."""
        self._nodes = nodes
        if self._received:
            self._receive()

    def run(
        self,
        node: Node,
        bus: NodeBus,
        realtime: RealtimeStatus = NO_REALTIME,
        *,
        freeze: bool = True,
        guarded: bool = False,
    ) -> None:
        """Run a node until it or a signal requests its stop.

        Args:
            node: The node.
            bus: The bus of the node.
            realtime: The scheduling that the process was granted.
            freeze: False for a process that needs the garbage collector for work after the loop.
            guarded: Whether the kernel ends the process if it computes without end (`HangGuard`).
        """
        guard = HangGuard()
        note_alive = guard.renew if guarded else lambda: None
        starting_ns = STARTING_PERIOD_NS
        loop = NodeLoop(node, bus, realtime, starting_period_ns=starting_ns, note_alive=note_alive)
        self.interrupt(node)
        if node.context.key in DEVICES:
            self._take_stops(loop)
        if freeze:
            # The garbage collector scans every object of the process, and other processes on this processor must keep
            # their periods.
            with ordinary_scheduling():
                freeze_garbage()
        with guard if guarded else contextlib.nullcontext():
            loop.run()

    def _take_stops(self, loop: NodeLoop) -> None:
        """Obey an emergency stop at STOP_SIGNAL, which needs no socket, and which only this user or root can send."""

        def stop(number: int, frame: FrameType | None) -> None:
            loop.note_stop_signal()
            self._continue_waiting()

        if STOP_SIGNAL is not None:
            signal.signal(STOP_SIGNAL, stop)

    def _receive(self) -> None:
        self._received = True
        if not self._nodes:
            return
        for node in self._nodes:
            node.interrupt()
        if not any(node.context.stop_requested for node in self._nodes):
            self._continue_waiting()

    def _continue_waiting(self) -> None:
        """Read the descriptor after a signal that does not end the loop, because it would end every further wait."""
        with contextlib.suppress(BlockingIOError):
            os.read(self.descriptor, 64)

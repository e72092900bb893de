"""The sockets of one process: plain ipc within its machine, CURVE between machines, and the state of every connection.

This module starts no Python thread: the node's loop calls `process_events` when a descriptor is readable or twice a
second, and each call does a bounded amount of work, so that a flood of connections cannot delay a loop. (A thread could
delay it: the interpreter makes a loop wait up to 5 ms for a busy thread.) libzmq serves strangers in a thread of lower
priority than the loop, and the kernel limits the number of connections.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

import zmq

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import PINGING_HIGH_WATER_MARK, ConnectionEvent, Subscriber
from telenano.runtime.bus.hearing import BEACON, Hearing, LocalConnections
from telenano.runtime.bus.local_endpoint import bound_by, fan_out_endpoint, is_bound, path_of
from telenano.runtime.bus.local_readers import LocalReaders, holders_of
from telenano.runtime.bus.places import Places
from telenano.runtime.bus.publisher import ZmqPublisher, bind
from telenano.runtime.bus.socket_monitor import RejectionCounter
from telenano.runtime.loop.realtime import lower_thread
from telenano.runtime.security.access_control import AccessControl
from telenano.runtime.security.keyring import Keyring
from telenano.runtime.security.peer_connections import PeerConnections
from telenano.runtime.security.private_files import check_runtime_directory
from telenano.runtime.security.zap_authenticator import ZapAuthenticator
from telenano.runtime.wiring.descriptors import Descriptors, descriptors_beyond, readers_of
from telenano.timing.clock import Clock
from telenano.wire.codec import WireError
from telenano.wire.errors import ConfigError, EndpointError
from telenano.wire.messages import InputHealth
from telenano.wire.nodes import is_estop

# A loop drops a connection on which it receives nothing for a second: a pulled cable causes no event, and messages sent
# meanwhile must not arrive later.
_LOOP_SILENCE_MS = 1000
# An observer may be late by seconds on a busy machine, and then answers heartbeats late as well.
_READER_SILENCE_MS = 5000
_HEARTBEATS = 4
# Enough for four round trips over a satellite link.
_HANDSHAKE_MS = 5000
# Connections that the system queues until this process accepts them; this process cannot limit those itself.
_BACKLOG = 16
# Without this limit the next attempt to connect may come minutes after the cable is back.
_CONNECT_MS = 2000
# A lost connection is made again after this time, which grows to _RECONNECT_MOST_MS.
_RECONNECT_MS = 100
_RECONNECT_MOST_MS = 1000
# The I/O thread, as a bit of the affinity, that accepts connections from other machines, makes the handshakes, and
# sends to the peers.
_SECOND_THREAD = 2
_SECOND_THREAD_NAME = "ZMQbg/IO/1"
# Interval of the checks, below the half second after which a loop calls at the latest, so that each such call checks.
_CHECK_NS = 400_000_000


P = TypeVar("P", bound=ZmqPublisher)


class BusContext(zmq.Context["zmq.Socket[bytes]"]):
    """A context that closes all its sockets at its end, even one that its owner could not close after an interruption.

    The context of pyzmq keeps only weak references to its sockets. If the garbage collector ends the generator that
    holds the context, as in a process that exits, these references are cleared first, and ending the context would wait
    for the open sockets for ever.
    """

    # pyzmq treats an attribute that the class does not declare as an option of ZeroMQ.
    opened: "Sequence[zmq.Socket[bytes]]" = ()

    def socket(self, *arguments: Any, **options: Any) -> "zmq.Socket[bytes]":
        """Open a socket as pyzmq does, and keep a reference to it until it is closed."""
        self.opened = [socket for socket in self.opened if not socket.closed]
        self.opened.append(super().socket(*arguments, **options))
        return self.opened[-1]

    def destroy(self, linger: int | None = None) -> None:
        """Close every socket and end the context; each sends queued messages for `linger` [ms], or for its LINGER."""
        for socket in self.opened:
            socket.close(linger)
        super().destroy(linger)


def open_context(*, serves_network: bool) -> BusContext:
    """Return a ZeroMQ context, with a second I/O thread if it serves endpoints that other machines can reach."""
    return BusContext(io_threads=2 if serves_network else 1)


class EstopInlet(Subscriber):
    """A SUB socket for emergency stops (ADR 0014).

    The node itself binds it, so that any number of senders can connect at the same time, without a lock. It accepts
    only `session/control` of `estop@site`, from which `CommandHandler` executes nothing but stops.
    """

    def __init__(self, context: "zmq.Context[zmq.Socket[bytes]]", clock: Clock, node: str, endpoint: str) -> None:
        """Bind an ipc endpoint for `node`; raise EndpointError with the reason if that fails."""
        super().__init__(context, clock, {endpoint: ["session/control"]}, connect=False, permit=_permit)
        self._listener = bind(self.socket, endpoint, node)
        self.shared = False

    def input_health(self) -> tuple[InputHealth, ...]:
        """Return the sequence statistics of every sender; silence is not reported, because it is the usual state."""
        return tuple(health for health in super().input_health() if health.src)

    def lost(self) -> str:
        """Return the path of the inlet if its file was removed or replaced; empty while it is in place."""
        return "" if self._listener is None else self._listener.lost()

    def make_again(self) -> None:
        """Bind the inlet again; raise EndpointError if that is not possible."""
        if self._listener is not None:
            self._listener.make_again()

    def close(self) -> None:
        """Close the socket and remove its file, so that the node does not appear to run."""
        super().close()
        if self._listener is not None:
            self._listener.remove()


def _permit(topic: str, src: str) -> None:
    if not is_estop(src):
        raise WireError("source", f"{topic}: {src} may not send at the inlet for emergency stops")


class NetworkHandler(Protocol):
    """Handler of one kind of connections, which a transport calls from time to time."""

    @property
    def sockets(self) -> Sequence["zmq.Socket[bytes]"]:
        """Sockets that become readable when there are events to process."""

    def process_events(self) -> bool:
        """Process a bounded number of pending events; return True if more are left."""

    def take_events(self) -> list[ConnectionEvent]:
        """Return the events since the last call."""

    def apply_permissions(self) -> None:
        """Apply a changed list of allowed keys."""

    def close(self) -> None:
        """Close the sockets that the handler has opened."""


class Transport:
    """Opens the sockets of a process, authenticates incoming connections, and maintains outgoing ones."""

    def __init__(
        self,
        context: "zmq.Context[zmq.Socket[bytes]]",
        clock: Clock,
        book: AddressBook,
        machine: str,
        keyring: Keyring | None = None,
        owner: str = "this process",
    ) -> None:
        """Read the keys of a machine if the rig requires any.

        Args:
            context: The context of ZeroMQ.
            clock: The clock of the process.
            book: The addresses of the rig.
            machine: The machine.
            keyring: The folder of keys of the machine; None for that of this user.
            owner: The name of the process in error messages.

        Raises:
            ConfigError: The machine has no key, or one that other users can read; or the folder of sockets belongs to
                another user or is open to others.
        """
        if book.uses_runtime_directory:
            check_runtime_directory()
        self.machine = machine
        self.owner = owner
        self.access_control = AccessControl(machine, keyring, requires_keys=book.requires_keys)
        self.has_pending = False
        self.context = context
        self.clock = clock
        self.book = book
        self._needed_files = Descriptors(int(context.get(zmq.IO_THREADS)))
        self._rejections = RejectionCounter()
        self._authenticator = ZapAuthenticator(context, self.access_control, self._rejections)
        self._peers: list[PeerConnections] = []
        self._handlers: list[NetworkHandler] = [self._authenticator]
        self._next_check_ns = clock.monotonic_ns() + _CHECK_NS
        self._lowered = True
        # Paths by which other processes of this machine reach this one; the loop of its node checks them.
        self.places = Places(self._prepare_folder)
        # The connections to all publishers.
        self.hearing = Hearing(clock)
        # The connections of other processes of this machine to this one.
        self.local_readers = LocalReaders(self._holders, lambda: descriptors_beyond(self._needed_files.needed))

    @property
    def descriptors(self) -> Sequence[int]:
        """Descriptors that become readable when there are events to process."""
        return [socket.fileno() for handler in self._handlers for socket in handler.sockets]

    @property
    def rejected(self) -> dict[str, int]:
        """Number of connections rejected or failed in the handshake, by reason."""
        return self._rejections.counts

    @property
    def last_error(self) -> str:
        """The newest rejection in words."""
        return self._rejections.last_error

    def publisher(self, key: str, kind: int = zmq.PUB, make: type[P] = ZmqPublisher) -> P:  # type: ignore[assignment]
        """Bind the endpoints of a node; raise EndpointError with the reason if that fails.

        Args:
            key: The node as node@site.
            kind: The kind of the ZeroMQ socket.
            make: The class of the publisher.
        """
        try:
            local, network = self.book.local_endpoint(key), self.book.bind_endpoint(key)
        except KeyError as error:
            raise EndpointError(str(error.args[0])) from error
        self._prepare_folder()
        self._needed_files.add_publisher(readers_of(self.book, key))
        self._needed_files.check(self.owner)
        if network is None:
            publisher = make(self.context, self.clock, key, local or "", kind=kind)
            self.places.add(publisher)
            self.local_readers.add(local)
            return publisher

        def prepare(socket: "zmq.Socket[bytes]") -> None:
            _set_network_options(socket, network)
            # The kernel drops a reader without pings that acknowledges nothing for this time.
            socket.set(zmq.TCP_MAXRT, _READER_SILENCE_MS)
            if self.context.get(zmq.IO_THREADS) > 1:
                socket.set(zmq.AFFINITY, _SECOND_THREAD)
                self._lowered = False
            self._authenticator.prepare(socket, key)

        try:
            if local is None:
                publisher = make(self.context, self.clock, key, network, kind=kind, prepare=prepare)
            else:
                # A bound endpoint keeps the options that the socket had at that moment, so ipc stays plain.
                publisher = make(self.context, self.clock, key, local, kind=kind)
                prepare(publisher.socket)
                publisher.also_bind(network)
        except EndpointError:
            self._authenticator.abandon(key)
            raise
        self._authenticator.add(publisher)
        self.places.add(publisher)
        self.local_readers.add(local)
        return publisher

    def subscribers(
        self,
        sources: Mapping[str, Sequence[str]],
        *,
        apart: bool = False,
        newest_only: bool = False,
        shared: bool = False,
    ) -> list[Subscriber]:
        """Connect to nodes (keys) for topics (values): one socket for this machine, one for each other machine.

        Args:
            sources: The topics by node.
            apart: Whether each node gets its own socket, in order, so that the endpoint of a message is known.
            newest_only: True for a reader that acts on the newest message of each `latest` topic.
            shared: With `apart`, whether to connect to the process that reads a node once for all observers.
        """
        if apart:
            # An observer shows or counts every message, so it is subscribed to no topic that it did not request.
            return [
                self._reader({node: topics}, _READER_SILENCE_MS, shared=shared, hears=BEACON in topics)
                for node, topics in sources.items()
            ]
        groups: dict[str, dict[str, Sequence[str]]] = {"": {}}
        for node, topics in sources.items():
            near = self.book.endpoint(node, self.machine).startswith("ipc://")
            groups.setdefault("" if near else self.book.machine_of(node), {})[node] = topics
        return [self._reader(plan, _LOOP_SILENCE_MS, newest_only=newest_only) for plan in groups.values()]

    def reader_of(self, machine: str, readers: Sequence[Subscriber]) -> Subscriber | None:
        """Return the reader among `readers` that receives from another machine, None if there is none."""
        return next((peers.subscriber for peers in self._peers_at(machine) if peers.subscriber in readers), None)

    def is_connected_to(self, machine: str) -> bool:
        """Return whether some node of another machine is connected now."""
        return any(peer.up for peers in self._peers_at(machine) for peer in peers.connections)

    def _peers_at(self, machine: str) -> Iterator[PeerConnections]:
        return (peers for peers in self._peers if peers.machine == machine)

    def connect_beside(self, node: str, subscriber: Subscriber) -> None:
        """Connect a second socket to a node; only the first one's connection reports its events."""
        endpoint, machine = self.book.connect_endpoint(node, self.machine), self.book.machine_of(node)
        _set_network_options(subscriber.socket, endpoint)
        _set_heartbeats(subscriber.socket, _LOOP_SILENCE_MS)
        parts = {node: endpoint}, subscriber, self.clock, self.access_control, RejectionCounter()
        self._follow_peers(PeerConnections(machine, *parts, is_reported=False, expects_beacon=False))

    def look_after(self, handler: NetworkHandler) -> None:
        """Add a handler, whose events are processed and to which changed permissions are applied from now on."""
        self._handlers.append(handler)

    def estop_inlet(self, key: str) -> EstopInlet | None:
        """Bind the endpoint for emergency stops of a node; return None if the address book has none for it."""
        endpoint = self.book.estop_endpoint(key)
        if endpoint is None:
            return None
        # Senders of stops connect only for a moment, so room for one is enough.
        self._needed_files.add_publisher(1)
        self._needed_files.check(self.owner)
        inlet = EstopInlet(self.context, self.clock, key, endpoint)
        self.places.add(inlet)
        self.local_readers.add(endpoint)
        return inlet

    def process_events(self) -> list[ConnectionEvent]:
        """Process authentication requests and connection events, and reload the list of keys if it has changed."""
        # The list makes every handler run, even if an earlier one has more to do.
        self.has_pending = any([handler.process_events() for handler in self._handlers])
        events = self._check()
        for handler in self._handlers:
            events += handler.take_events()
        return events

    def close(self) -> None:
        """Close all sockets besides those of publishers and subscribers."""
        for handler in self._handlers:
            handler.close()

    def _prepare_folder(self) -> None:
        """Make the private folder of sockets if the rig uses one; raise ConfigError if other users can reach it."""
        if self.book.uses_runtime_directory:
            check_runtime_directory(make=True)

    def _reader(
        self,
        plan: Mapping[str, Sequence[str]],
        silence_ms: int,
        *,
        newest_only: bool = False,
        shared: bool = False,
        hears: bool = True,
    ) -> Subscriber:
        self._needed_files.add_reader(len(plan))
        self._needed_files.check(self.owner)
        endpoints = {node: self.book.connect_endpoint(node, self.machine) for node in plan}
        if shared:
            further = {node: fan_out_endpoint(endpoint) for node, endpoint in endpoints.items()}
            endpoints |= {node: endpoint for node, endpoint in further.items() if is_bound(endpoint)}
        by_endpoint = {endpoints[node]: topics for node, topics in plan.items()}
        subscriber = Subscriber(self.context, self.clock, by_endpoint, connect=False, newest_only=newest_only)
        if not any(endpoint.startswith("tcp://") for endpoint in by_endpoint):
            # Its socket is called at looks alone, after which it is read.
            subscriber.shared = False
            local = LocalConnections(endpoints, subscriber, self.clock)
            self.hearing.readers.append(local)
            self._handlers.append(local)
        else:
            subscriber.socket.set(zmq.RCVHWM, PINGING_HIGH_WATER_MARK)
            _set_network_options(subscriber.socket, *by_endpoint)
            _set_heartbeats(subscriber.socket, silence_ms)
            machine = self.book.machine_of(next(iter(plan)))
            parts = endpoints, subscriber, self.clock, self.access_control, self._rejections
            self._follow_peers(PeerConnections(machine, *parts, expects_beacon=hears))
        if hears and BEACON not in subscriber.topics:
            subscriber.hear_beacon(BEACON)
        return subscriber

    def _follow_peers(self, peers: PeerConnections) -> None:
        """Look after connections to another machine from now on."""
        self._peers.append(peers)
        self._handlers.append(peers)

    def _check(self) -> list[ConnectionEvent]:
        now = self.clock.monotonic_ns()
        if now < self._next_check_ns:
            return []
        self._next_check_ns = now + _CHECK_NS
        if not self._lowered:
            # The thread sets its name itself after its start, so it cannot be found earlier.
            self._lowered = True
            lower_thread(_SECOND_THREAD_NAME)
        events = []
        try:
            if self.access_control.reload():
                for handler in self._handlers:
                    handler.apply_permissions()
        except ConfigError as error:
            events.append(ConnectionEvent("error", f"the list of keys was not reloaded: {error}", {}))
        for closed in self.local_readers.look():
            text = f"{closed.number} connections of process {closed.process} were closed: {closed.reason}"
            events.append(ConnectionEvent("warning", text, {"process": closed.process, "count": closed.number}))
        self.hearing.look(now)
        for peers in self._peers:
            peers.maintain(now)
        return events

    def _holders(self) -> set[int]:
        """Return the processes of this machine that are nodes of the site file, and the one that serves observers."""
        endpoints = (self.book.local_endpoint(node) for node in self.book.nodes)
        nodes = holders_of(Path(f"{path_of(endpoint)}.lock") for endpoint in endpoints if endpoint is not None)
        serving = (bound_by(fan_out_endpoint(f"ipc://{path}")) for path in self.local_readers.paths)
        return nodes | {peer.process for peer in serving if peer is not None}


def _set_heartbeats(socket: "zmq.Socket[bytes]", silence_ms: int) -> None:
    """Make a reader drop a connection that is silent for a time [ms], and its publisher one without the reader's pings.

    Publishers send no pings. If bytes of a connection were altered and the connection is then reset, the next ping from
    the accepting side would abort its process: `Assertion failed: !_io_error (src/stream_engine_base.cpp:310)`.
    """
    socket.set(zmq.HEARTBEAT_IVL, silence_ms // _HEARTBEATS)
    socket.set(zmq.HEARTBEAT_TIMEOUT, silence_ms)
    socket.set(zmq.HEARTBEAT_TTL, _READER_SILENCE_MS)


def _set_network_options(socket: "zmq.Socket[bytes]", *endpoints: str) -> None:
    if any("[" in endpoint for endpoint in endpoints):
        socket.set(zmq.IPV6, 1)
    socket.set(zmq.HANDSHAKE_IVL, _HANDSHAKE_MS)
    socket.set(zmq.BACKLOG, _BACKLOG)
    socket.set(zmq.CONNECT_TIMEOUT, _CONNECT_MS)
    socket.set(zmq.RECONNECT_IVL, _RECONNECT_MS)
    socket.set(zmq.RECONNECT_IVL_MAX, _RECONNECT_MOST_MS)

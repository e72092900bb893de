"""The sockets of one process: plain ipc within its machine, CURVE between machines, and the state of every connection.

No Python here runs in a thread of its own: the node's loop calls `process_events` when a descriptor is readable or
twice a second, and each call does a bounded amount of work, so that a flood of connections cannot delay a loop. (A
thread could: the interpreter makes a loop wait up to 5 ms for one that is busy.) What libzmq does for strangers it does
in a thread that comes behind the loop, and the kernel limits how much that is.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, TypeVar

import zmq

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.bus.bus import PINGING_HIGH_WATER_MARK, ConnectionEvent, Subscriber
from telenano.runtime.bus.hearing import BEACON, Hearing
from telenano.runtime.bus.local_endpoint import fan_out_endpoint, is_bound
from telenano.runtime.bus.places import Places
from telenano.runtime.bus.publisher import ZmqPublisher, bind
from telenano.runtime.loop.realtime import lower_thread
from telenano.runtime.security.access_control import AccessControl
from telenano.runtime.security.keyring import Keyring
from telenano.runtime.security.peer_connections import PeerConnections
from telenano.runtime.security.private_files import check_runtime_directory
from telenano.runtime.security.socket_monitor import RejectionCounter
from telenano.runtime.security.zap_authenticator import ZapAuthenticator
from telenano.runtime.wiring.descriptors import Descriptors, readers_of
from telenano.timing.clock import Clock
from telenano.wire.codec import WireError
from telenano.wire.errors import ConfigError, EndpointError
from telenano.wire.messages import InputHealth
from telenano.wire.nodes import is_estop

# a loop gives up a connection on which nothing is received for a second: a pulled cable gives no event, and what was
# sent meanwhile must not arrive later
_LOOP_SILENCE_MS = 1000
# an observer may be late by seconds on a busy machine, and answers heartbeats as late
_READER_SILENCE_MS = 5000
_HEARTBEATS = 4
# four round trips of a satellite link
_HANDSHAKE_MS = 5000
# The system accepts this number of connections ahead of this process, for which a limit comes too late.
_BACKLOG = 16
# Without this limit the next attempt to connect may come minutes after the cable is back.
_CONNECT_MS = 2000
# A lost connection is made again after this time, which grows to _RECONNECT_MOST_MS.
_RECONNECT_MS = 100
_RECONNECT_MOST_MS = 1000
# This thread of the context, as a bit of the affinity, accepts connections, fails handshakes, and sends to those that
# succeeded.
_SECOND_THREAD = 2
_SECOND_THREAD_NAME = "ZMQbg/IO/1"
# It is below the half second after which a loop calls at the latest, so that each such call checks.
_CHECK_NS = 400_000_000


P = TypeVar("P", bound=ZmqPublisher)


class BusContext(zmq.Context["zmq.Socket[bytes]"]):
    """A context whose end closes every socket of it, also one that an interruption kept from being closed by its owner.

    The context of the library knows its sockets by weak references. Where the garbage collector ends the generator that
    has the context, as in a process that exits, it has cleared them before, and the end waits for those sockets.
    """

    # The library takes an attribute that its class does not have for an option of ZeroMQ.
    opened: "Sequence[zmq.Socket[bytes]]" = ()

    def socket(self, *arguments: Any, **options: Any) -> "zmq.Socket[bytes]":
        """Open a socket as the library does, and keep it until it is closed."""
        self.opened = [socket for socket in self.opened if not socket.closed]
        self.opened.append(super().socket(*arguments, **options))
        return self.opened[-1]

    def destroy(self, linger: int | None = None) -> None:
        """Close every socket and end the context; each sends what it has left as long as its own LINGER permits."""
        for socket in self.opened:
            socket.close(linger)
        super().destroy(linger)


def open_context(*, serves_network: bool) -> BusContext:
    """Return a ZeroMQ context, with a thread of its own for endpoints that other machines can reach."""
    return BusContext(io_threads=2 if serves_network else 1)


class EstopInlet(Subscriber):
    """A SUB socket for emergency stops (ADR 0014).

    The node binds it itself, so that any number of senders can connect, at once and without a lock.
    It takes `session/control` of `estop@site` only, which `CommandHandler` lets stop and do nothing else.
    """

    def __init__(self, context: "zmq.Context[zmq.Socket[bytes]]", clock: Clock, node: str, endpoint: str) -> None:
        """Bind an ipc endpoint for `node`; EndpointError says why that fails."""
        super().__init__(context, clock, {endpoint: ["session/control"]}, connect=False, permit=_permit)
        self._listener = bind(self.socket, endpoint, node)
        self.shared = False

    def input_health(self) -> tuple[InputHealth, ...]:
        """Return the sequence statistics of every sender; silence is nothing to report."""
        return tuple(health for health in super().input_health() if health.src)

    def lost(self) -> str:
        """Return its path where another file or none stands there by now; empty while it is in place."""
        return "" if self._listener is None else self._listener.lost()

    def make_again(self) -> None:
        """Bind it again; EndpointError where that is not possible."""
        if self._listener is not None:
            self._listener.make_again()

    def close(self) -> None:
        """Close the socket and remove it from its folder, so that the node is not taken for one that runs."""
        super().close()
        if self._listener is not None:
            self._listener.remove()


def _permit(topic: str, src: str) -> None:
    if not is_estop(src):
        raise WireError("source", f"{topic}: {src} may not send at the inlet for emergency stops")


class NetworkHandler(Protocol):
    """What a transport looks after: connections of one kind, and what they need from time to time."""

    @property
    def sockets(self) -> Sequence["zmq.Socket[bytes]"]:
        """What becomes readable when there are events to process."""

    def process_events(self) -> bool:
        """Process pending events, a bounded number; True when more are left."""

    def take_events(self) -> list[ConnectionEvent]:
        """Return what happened since the last call."""

    def apply_permissions(self) -> None:
        """Act on a list of allowed keys that has changed."""

    def close(self) -> None:
        """Close what it has opened."""


class Transport:
    """Opens the sockets of a process, authenticates connections from other machines, and keeps those to them up."""

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
            keyring: Its folder of keys; None for that of this user.
            owner: Who has the sockets, as an error names it.

        Raises:
            ConfigError: The machine has no key, or one that other users can read, or other users can reach the folder
                of sockets.
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
        # Where other processes of this machine reach this one; the loop of its node looks after them.
        self.places = Places(self._prepare_folder)
        # Whether the publishers on this machine that send are heard.
        self.hearing = Hearing(context, clock)

    @property
    def descriptors(self) -> Sequence[int]:
        """What becomes readable when there are events to process."""
        return [socket.fileno() for handler in self._handlers for socket in handler.sockets]

    @property
    def rejected(self) -> dict[str, int]:
        """How often a connection was rejected or its handshake failed, by reason."""
        return self._rejections.counts

    @property
    def last_error(self) -> str:
        """The newest rejection in words."""
        return self._rejections.last_error

    def publisher(self, key: str, kind: int = zmq.PUB, make: type[P] = ZmqPublisher) -> P:  # type: ignore[assignment]
        """Bind the endpoints of a node by a socket of a class; EndpointError gives the reason if that fails."""
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
            return publisher

        def prepare(socket: "zmq.Socket[bytes]") -> None:
            _set_network_options(socket, network)
            # A reader without pings is given up by the kernel, where it acknowledges nothing for so long.
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
            apart: Whether each node gets a socket of its own, in order, so that the endpoint of a message is known.
            newest_only: True for a reader that acts on the newest message of each `latest` topic.
            shared: Whether the rig may read the node once for all observers, where these are apart.
        """
        if apart:
            # Of an observer each message is shown or counted, so that it is given no topic that it did not ask for.
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
        """Return which of `readers` receives from another machine, None where none does."""
        return next(
            (peers.subscriber for peers in self._peers if peers.machine == machine and peers.subscriber in readers),
            None,
        )

    def is_connected_to(self, machine: str) -> bool:
        """Return whether some node of another machine is connected now."""
        return any(peer.up for peers in self._peers if peers.machine == machine for peer in peers.connections)

    def connect_beside(self, node: str, subscriber: Subscriber) -> None:
        """Connect a socket to a node that another socket is connected to as well, which alone reports what happens."""
        endpoint, machine = self.book.connect_endpoint(node, self.machine), self.book.machine_of(node)
        _set_network_options(subscriber.socket, endpoint)
        _set_heartbeats(subscriber.socket, _LOOP_SILENCE_MS)
        parts = {node: endpoint}, subscriber, self.clock, self.access_control, RejectionCounter()
        peers = PeerConnections(machine, *parts, is_reported=False)
        self._peers.append(peers)
        self._handlers.append(peers)

    def look_after(self, handler: NetworkHandler) -> None:
        """Have a further kind of connection take part in what is done from time to time."""
        self._handlers.append(handler)

    def estop_inlet(self, key: str) -> EstopInlet | None:
        """Bind where a node takes emergency stops; None where it has no ipc endpoint."""
        endpoint = self.book.estop_endpoint(key)
        if endpoint is None:
            return None
        # Those who send stops come for a moment, and one is enough.
        self._needed_files.add_publisher(1)
        self._needed_files.check(self.owner)
        inlet = EstopInlet(self.context, self.clock, key, endpoint)
        self.places.add(inlet)
        return inlet

    def process_events(self) -> list[ConnectionEvent]:
        """Process authentication requests and connection events, and reload the list of keys if it has changed."""
        # Every handler runs, and none is left out because another one has more to do.
        self.has_pending = any([handler.process_events() for handler in self._handlers])
        events = self._check()
        for handler in self._handlers:
            events += handler.take_events()
        return events + self.hearing.look()

    def close(self) -> None:
        """Close the sockets that are not closed with the publishers and subscribers."""
        self.hearing.close()
        for handler in self._handlers:
            handler.close()

    def _prepare_folder(self) -> None:
        """Make the private folder of sockets, if the rig has one; ConfigError where it belongs to another user."""
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
        if not any(endpoint.startswith("tcp://") for endpoint in by_endpoint):
            reader = Subscriber(self.context, self.clock, by_endpoint, newest_only=newest_only)
            if hears:
                self.hearing.add(reader, endpoints)
            return reader
        subscriber = Subscriber(self.context, self.clock, by_endpoint, connect=False, newest_only=newest_only)
        subscriber.socket.set(zmq.RCVHWM, PINGING_HIGH_WATER_MARK)
        _set_network_options(subscriber.socket, *by_endpoint)
        _set_heartbeats(subscriber.socket, silence_ms)
        machine = self.book.machine_of(next(iter(plan)))
        peers = PeerConnections(machine, endpoints, subscriber, self.clock, self.access_control, self._rejections)
        self._peers.append(peers)
        self._handlers.append(peers)
        return subscriber

    def _check(self) -> list[ConnectionEvent]:
        now = self.clock.monotonic_ns()
        if now < self._next_check_ns:
            return []
        self._next_check_ns = now + _CHECK_NS
        if not self._lowered:
            # The thread gives itself its name, so it cannot be found earlier.
            self._lowered = True
            lower_thread(_SECOND_THREAD_NAME)
        events = []
        try:
            if self.access_control.reload():
                for handler in self._handlers:
                    handler.apply_permissions()
        except ConfigError as error:
            events.append(ConnectionEvent("error", f"the list of keys was not reloaded: {error}", {}))
        for peers in self._peers:
            peers.maintain(now)
        return events


def _set_heartbeats(socket: "zmq.Socket[bytes]", silence_ms: int) -> None:
    """Have a reader give up a connection that is silent for a time [ms], and its publisher one without its pings.

    Publishers send no pings of their own. Where bytes of a connection are altered and it is then reset, the next ping
    of the side that accepted it ends the process: `Assertion failed: !_io_error (src/stream_engine_base.cpp:310)`.
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

"""The UDP sockets of `telenano link udp`: one to which clients send, and one for each client towards the target."""

import contextlib
import errno
import resource
import select
import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from telenano.timing import NEVER_NS
from telenano.wire import ConfigError, Received
from telenano_lab.networks.network_trace import Direction

# The largest datagram of UDP is smaller than this.
_MOST_BYTES = 65_536
# The most datagrams that are read from a socket in a turn, so that a flood at one delays the others no longer.
_MOST_A_TURN = 64
_BUFFER_BYTES = 4 << 20
# If all places are taken, a client that was silent for longer than this gives its place to a new one.
IDLE_NS = 10_000_000_000
# Further descriptors of the link: the recording, connections of consoles, and kernel files that it reads.
_OTHER_DESCRIPTORS = 32
# SO_MEMINFO of Linux (include/uapi/asm-generic/socket.h) returns nine counts, the last of which is that of drops.
_SO_MEMINFO = 55
_MEMINFO_COUNTS = 9
LOOPBACK = "127.0.0.1"


class Place(NamedTuple):
    """A host and a port, as they were given."""

    host: str
    port: int

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def place_of(text: str, what: str, *, needs_host: bool) -> Place:
    """Return the place in HOST:PORT or [HOST]:PORT; a port alone is one of this machine.

    Raises:
        ConfigError: The text is neither; the message begins with `what`.
    """
    host, _, port = text.rpartition(":")
    if host.startswith("[") and host.endswith("]"):
        host = host[1:-1]
    elif ":" in host:
        raise ConfigError(f"{what} {text!r}: an IPv6 address needs brackets, such as [::1]:5000")
    if not (port.isascii() and port.isdigit() and 0 < int(port) < 65_536):
        raise ConfigError(f"{what} {text!r}: needs a port from 1 to 65535, such as 127.0.0.1:5000")
    if not host and needs_host:
        raise ConfigError(f"{what} {text!r}: needs a host, such as 127.0.0.1:{port}")
    return Place(host or LOOPBACK, int(port))


class Client:
    """A client: its address at the listening socket, and its own socket towards the target."""

    def __init__(self, address: tuple[object, ...], upstream: socket.socket) -> None:
        self.address = address
        self.upstream = upstream
        self.heard_ns = 0


class UdpPorts:
    """Reads datagrams for a node as the bus reads messages, and sends those that the node releases.

    `take` is called with the direction, the datagram and the name of its client. A datagram that cannot be sent is
    counted in `unsent` by the reason; one from a client for which there is no place or no descriptor in `refused`.
    """

    def __init__(
        self, listen: Place, target: Place, most_clients: int, monotonic_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """Bind the listening socket.

        Raises:
            ConfigError: The address is in use or not of this machine, or the target has none.
        """
        self._monotonic_ns = monotonic_ns
        self._most_clients = most_clients
        self.take: Callable[[Direction, bytes, str], None] = lambda direction, payload, name: None
        self.clients: dict[str, Client] = {}
        self.unsent: dict[str, int] = {}
        self.refused = 0
        self._overflowed_backward = 0
        self.target = _resolved(target, "the target", socket.AF_UNSPEC, 0)
        family, address = _resolved(listen, "the address to listen at", socket.AF_UNSPEC, socket.AI_PASSIVE)
        self._listener = _opened(family)
        self._poll = select.epoll()
        try:
            self._listener.bind(address)
        except OSError as error:
            self.close()
            raise ConfigError(f"cannot listen at {listen}: {error.strerror}") from error
        self.address: tuple[object, ...] = self._listener.getsockname()
        self._poll.register(self._listener, select.EPOLLIN)
        self._by_descriptor: dict[int, str] = {}
        # The attributes that a bus needs of a reader.
        self.descriptor = self._poll.fileno()
        self.drained, self.shared, self.due_ns = True, False, NEVER_NS
        self.trackers: dict[tuple[str, str], Any] = {}
        self.rejected: dict[str, int] = {}
        self.last_error = ""

    def receive(self, *, signalled: bool = False) -> list[Received]:
        """Pass on the datagrams that have arrived; return no messages of the bus, because there are none among them."""
        self.drained = True
        for descriptor, _ in self._poll.poll(0):
            name = self._by_descriptor.get(descriptor)
            if name is None:
                self._take_from_clients()
            elif (client := self.clients.get(name)) is not None:
                self._take_answers(name, client)
        return []

    def input_health(self) -> tuple[()]:
        """Return nothing: datagrams have no numbers that would show a loss."""
        return ()

    def send(self, direction: Direction, payload: bytes, name: str) -> None:
        """Send a datagram to the target on behalf of a client, or back to the client."""
        client = self.clients.get(name)
        if client is None:
            self._count("client gone")
            return
        try:
            if direction == "forward":
                client.upstream.send(payload)
            else:
                self._listener.sendto(payload, client.address)
        except OSError as error:
            self._count(_reason(error))

    def overflowed(self) -> dict[Direction, int]:
        """Return the number of datagrams in each direction that the kernel dropped at full sockets here."""
        backward = sum(overflowed(client.upstream) for client in self.clients.values())
        return {"forward": overflowed(self._listener), "backward": self._overflowed_backward + backward}

    def close(self) -> None:
        """Close all sockets."""
        for client in self.clients.values():
            client.upstream.close()
        self.clients.clear()
        self._listener.close()
        self._poll.close()

    def _take_from_clients(self) -> None:
        for _ in range(_MOST_A_TURN):
            try:
                payload, address = self._listener.recvfrom(_MOST_BYTES)
            except BlockingIOError:
                return
            except OSError as error:
                # A datagram to a client that has ended comes back as an error of the sending socket.
                self._count(_reason(error))
                continue
            name = f"{address[0]}:{address[1]}"
            client = self.clients.get(name) or self._admit(name, address)
            if client is None:
                self.refused += 1
                continue
            client.heard_ns = self._monotonic_ns()
            self.take("forward", payload, name)
        self.drained = False

    def _take_answers(self, name: str, client: Client) -> None:
        for _ in range(_MOST_A_TURN):
            try:
                payload = client.upstream.recv(_MOST_BYTES)
            except BlockingIOError:
                return
            except OSError as error:
                self._count(_reason(error))
                continue
            self.take("backward", payload, name)
        self.drained = False

    def _admit(self, name: str, address: tuple[object, ...]) -> Client | None:
        if len(self.clients) >= self._most_clients and not self._forget_idle():
            return None
        family, target = self.target
        with contextlib.ExitStack() as opened:
            try:
                upstream = opened.enter_context(_opened(family))
                upstream.connect(target)
                self._poll.register(upstream, select.EPOLLIN)
            except OSError as error:
                self._count(_reason(error))
                return None
            opened.pop_all()
        self._by_descriptor[upstream.fileno()] = name
        client = self.clients[name] = Client(address, upstream)
        return client

    def _forget_idle(self) -> bool:
        """Remove the client that was silent for longest, if for over IDLE_NS; return whether one was removed."""
        name, client = min(self.clients.items(), key=lambda item: item[1].heard_ns)
        if self._monotonic_ns() - client.heard_ns < IDLE_NS:
            return False
        del self.clients[name], self._by_descriptor[client.upstream.fileno()]
        self._overflowed_backward += overflowed(client.upstream)
        self._poll.unregister(client.upstream)
        client.upstream.close()
        return True

    def _count(self, reason: str) -> None:
        self.unsent[reason] = self.unsent.get(reason, 0) + 1


def make_room_for(clients: int) -> None:
    """Raise this process's limit of open files so that each of a number of clients can have a descriptor.

    Raises:
        ConfigError: The system permits fewer; the message states the most clients possible.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    needed = clients + sum(1 for _ in Path("/proc/self/fd").iterdir()) + _OTHER_DESCRIPTORS
    if hard != resource.RLIM_INFINITY and needed > hard:
        raise ConfigError(
            f"--clients {clients}: needs {needed} open files, and this process may have {hard} (ulimit -n): "
            f"{max(0, clients - (needed - hard))} clients at most"
        )
    if soft != resource.RLIM_INFINITY and needed > soft:
        resource.setrlimit(resource.RLIMIT_NOFILE, (needed, hard))


def overflowed(opened: socket.socket) -> int:
    """Return the number of datagrams that the kernel dropped at a full socket; 0 if the system does not report it."""
    try:
        counts = opened.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, 4 * _MEMINFO_COUNTS)
    except OSError:
        return 0
    return int(struct.unpack(f"{_MEMINFO_COUNTS}I", counts)[-1]) if len(counts) == 4 * _MEMINFO_COUNTS else 0


def _opened(family: int) -> socket.socket:
    opened = socket.socket(family, socket.SOCK_DGRAM)
    opened.setblocking(False)
    with contextlib.suppress(OSError):
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        if family == socket.AF_INET6:
            opened.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
    return opened


def _resolved(place: Place, what: str, family: int, flags: int) -> tuple[int, tuple[object, ...]]:
    try:
        addresses = socket.getaddrinfo(place.host, place.port, family, socket.SOCK_DGRAM, 0, flags)
    except (OSError, UnicodeError) as error:
        raise ConfigError(f"{what} {place} has no address: {getattr(error, 'strerror', None) or error}") from error
    return addresses[0][0], addresses[0][4]


def _reason(error: OSError) -> str:
    reasons = {
        errno.ECONNREFUSED: "no process listens",
        errno.EMSGSIZE: "too long",
        errno.EHOSTUNREACH: "host unreachable",
        errno.ENETUNREACH: "network unreachable",
        errno.EAGAIN: "socket full",
        errno.ENOBUFS: "socket full",
        errno.EMFILE: "no descriptors",
        errno.ENFILE: "no descriptors",
    }
    return reasons.get(error.errno or 0, error.strerror or str(error))

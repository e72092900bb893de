"""Limit on the connections of the page's server, so that file descriptors remain for the bus and emergency stops."""

import asyncio
import contextlib
import os
import socket
import time
from dataclasses import dataclass
from typing import Any

from telenano.runtime.wiring.descriptors import descriptors_free
from telenano.wire.errors import EndpointError

# Most connections. Those of pages need few others: a page loads its files over six at once, and a hello is short.
MOST_CONNECTIONS = 64
# Longest wait for the head of a request or the hello of a page [s].
SILENCE_S = 5.0
_SWEEP_S = 0.5
# File descriptors reserved for the bus: for nodes that start later, a console, the hand of a page.
_FOR_THE_BUS = 48
# Reserved for two simultaneous emergency stops; one was counted to need 22 at its inlets and 16 at a console.
_FOR_STOPS = 80
# Reserved for dropped connections, which keep their descriptors until the next turn of the event loop.
_CLOSING = 16


@dataclass
class _Connection:
    socket: socket.socket
    # Time since which the head of a request is awaited [s]; None while a request is being answered.
    since_s: float | None
    is_page: bool = False
    is_dropped: bool = False

    def drop(self) -> None:
        """Shut down both directions; the task that reads or writes the socket then closes it."""
        self.is_dropped = True
        with contextlib.suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)


class Connections:
    """The open connections, from the oldest to the newest.

    A connection is a stranger until it has shown a token. At the limit the oldest stranger is dropped for a new one, so
    a client that holds connections open cannot keep others out.
    """

    def __init__(self, most: int = MOST_CONNECTIONS) -> None:
        self.most = most
        self._open: dict[Any, _Connection] = {}

    def make_room(self) -> bool:
        """Return whether a connection may be accepted now; at the limit, drop the oldest stranger."""
        self._open = {
            client: connection for client, connection in self._open.items() if connection.socket.fileno() >= 0
        }
        kept = [connection for connection in self._open.values() if not connection.is_dropped]
        if len(kept) >= self.most:
            stranger = next((connection for connection in kept if not connection.is_page), None)
            if stranger is None:
                return False
            stranger.drop()
        return len(self._open) < self.most + _CLOSING

    def add(self, accepted: socket.socket, client: Any) -> None:
        """Add an accepted connection; `client` is its remote address and port."""
        self._open[client] = _Connection(accepted, time.monotonic())

    def begin(self, client: Any) -> None:
        """Record that the head of a request was received."""
        if connection := self._open.get(client):
            connection.since_s = None

    def end(self, client: Any) -> None:
        """Record that a request was answered and the next one of the same connection is awaited."""
        if connection := self._open.get(client):
            connection.since_s = time.monotonic()

    def admit(self, client: Any) -> None:
        """Record that a connection has shown a token, so that it is never dropped for another."""
        if connection := self._open.get(client):
            connection.is_page = True

    def drop(self, client: Any) -> None:
        """Drop a connection, even of a page: it was told to end, and its client reads nothing."""
        if (connection := self._open.get(client)) and not connection.is_dropped:
            connection.drop()

    def drop_silent(self) -> None:
        """Drop the connections whose request has not come within `SILENCE_S`."""
        now_s = time.monotonic()
        for connection in self._open.values():
            if connection.since_s is not None and now_s - connection.since_s > SILENCE_S and not connection.is_dropped:
                connection.drop()

    async def sweep(self) -> None:
        """Drop silent connections periodically, until cancelled."""
        while True:
            self.drop_silent()
            await asyncio.sleep(_SWEEP_S)


class Listener(socket.socket):
    """A listening socket that limits the number of connections.

    The limit is here because the web server counts a connection only after its handshake and the head of its first
    request.
    """

    connections: Connections | None = None

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection; raise BlockingIOError at the limit, as if none were waiting."""
        if self.connections is not None and not self.connections.make_room():
            raise BlockingIOError
        accepted, address = super().accept()
        if self.connections is not None:
            self.connections.add(accepted, address[:2])
        return accepted, address

    def again(self, connections: Connections) -> "Listener":
        """Return a duplicate of this socket for a server that closes it, limited by `connections`."""
        listener = Listener(fileno=os.dup(self.fileno()))
        listener.connections = connections
        return listener


def most_connections(least: int) -> int:
    """Return the number of connections that the file descriptors allow; raise EndpointError if less than `least`."""
    free = descriptors_free()
    if free is None:
        return MOST_CONNECTIONS
    most = min(MOST_CONNECTIONS, free - _FOR_THE_BUS - _FOR_STOPS - _CLOSING)
    if most < least:
        needed = least - most
        raise EndpointError(f"the view needs {needed} more open files than this process may have: raise `ulimit -n`")
    return most

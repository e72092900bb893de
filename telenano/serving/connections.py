"""The connections of the page's server: so many that descriptors are left for the bus and for emergency stops."""

import asyncio
import contextlib
import os
import socket
import time
from dataclasses import dataclass
from typing import Any

from telenano.runtime.wiring.descriptors import descriptors_free
from telenano.wire.errors import EndpointError

# Connections beside the pages are strangers: the files of a page come over six at once, and a hello takes moments.
MOST_CONNECTIONS = 64
# A request's head, or the hello of a page, that has not come after this time does not come.
SILENCE_S = 5.0
_SWEEP_S = 0.5
# This number of descriptors are left for the bus: nodes that come later, a console, the hand of a page.
_FOR_THE_BUS = 48
# These are left for two emergency stops at once, of which one was counted to need 22 at its inlets and 16 at a console.
_FOR_STOPS = 80
# Dropped connections keep their descriptors until the loop has come round.
_CLOSING = 16


@dataclass
class _Connection:
    socket: socket.socket
    # since when the head of a request is waited for [s]; None while one is being answered
    since_s: float | None
    is_page: bool = False
    is_dropped: bool = False

    def drop(self) -> None:
        """End both directions; the task that reads or writes it closes it then."""
        self.is_dropped = True
        with contextlib.suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)


class Connections:
    """Those that are open, from the oldest to the newest.

    A connection is a stranger until it has shown a token. Where there are as many as may be, the oldest stranger gives
    way to a new one, so a client that holds connections open keeps no other out.
    """

    def __init__(self, most: int = MOST_CONNECTIONS) -> None:
        self.most = most
        self._open: dict[Any, _Connection] = {}

    def make_room(self) -> bool:
        """Return whether a connection may be accepted now; drops the oldest stranger where there are too many."""
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
        """Take a connection that was accepted; `client` is its address and port."""
        self._open[client] = _Connection(accepted, time.monotonic())

    def begin(self, client: Any) -> None:
        """Record that the head of a request has come."""
        if connection := self._open.get(client):
            connection.since_s = None

    def end(self, client: Any) -> None:
        """Record that a request has been answered: the next one of the same connection may follow."""
        if connection := self._open.get(client):
            connection.since_s = time.monotonic()

    def admit(self, client: Any) -> None:
        """Record that a connection has shown a token: it gives way to no other."""
        if connection := self._open.get(client):
            connection.is_page = True

    def drop_silent(self) -> None:
        """Drop what has waited for the head of a request for too long."""
        now_s = time.monotonic()
        for connection in self._open.values():
            if connection.since_s is not None and now_s - connection.since_s > SILENCE_S and not connection.is_dropped:
                connection.drop()

    async def sweep(self) -> None:
        """Drop the silent ones now and again, until cancelled."""
        while True:
            self.drop_silent()
            await asyncio.sleep(_SWEEP_S)


class Listener(socket.socket):
    """A listening socket that accepts no more connections than there may be.

    The bound is here and not in the web server, which counts a connection only when its handshake is over and the head
    of its first request is there.
    """

    connections: Connections | None = None

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection. Raises BlockingIOError while there is no room, as if none were waiting."""
        if self.connections is not None and not self.connections.make_room():
            raise BlockingIOError
        accepted, address = super().accept()
        if self.connections is not None:
            self.connections.add(accepted, address[:2])
        return accepted, address

    def again(self, connections: Connections) -> "Listener":
        """Return another descriptor of the same socket, for a server that closes it."""
        listener = Listener(fileno=os.dup(self.fileno()))
        listener.connections = connections
        return listener


def most_connections(least: int) -> int:
    """Return how many connections the descriptors of this process allow; EndpointError where they allow too few."""
    free = descriptors_free()
    if free is None:
        return MOST_CONNECTIONS
    most = min(MOST_CONNECTIONS, free - _FOR_THE_BUS - _FOR_STOPS - _CLOSING)
    if most < least:
        needed = least - most
        raise EndpointError(f"the view needs {needed} more open files than this process may have: raise `ulimit -n`")
    return most

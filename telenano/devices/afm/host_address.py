"""The address of a device that is given by name, looked up without blocking the loop.

A name server that does not answer blocks its caller for ten seconds and more: harmless when a device is opened, but
fatal for a tip in the loop. So a separate thread asks, and the loop polls for the answer.
"""

import queue
import socket
import threading
from collections.abc import Callable
from typing import Any, NamedTuple

LookUp = Callable[[str, int], list[Any]]


class Address(NamedTuple):
    """Family and address to connect to, in the form of the socket module."""

    family: int
    address: Any


class HostAddress:
    """The address of one host and port."""

    def __init__(self, host: str, port: int, look_up: LookUp | None = None) -> None:
        """Begin to look up a name; a numeric address needs none. `look_up` replaces getaddrinfo in a test."""
        self._host, self._port = host, port
        self._look_up: LookUp = look_up or _of_the_system
        self._wanted: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._under_way = False
        self._found: Address | OSError | None = None
        try:
            self._found = _first(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST))
            self._is_name = False
        except OSError:
            self._is_name = True
            # It is a daemon thread, so that the end of the process does not wait for a name server.
            threading.Thread(target=self._answer, name=f"address of {host}", daemon=True).start()
            self.renew()

    def renew(self) -> None:
        """Look the name up again, unless that is under way; the last address is valid until there is a newer one."""
        if self._is_name and not self._under_way:
            self._under_way = True
            self._wanted.put(None)

    def poll(self) -> Address | None:
        """Return the newest address, or None while there is none yet; raise OSError if the name is not known."""
        address = self._found
        if isinstance(address, OSError):
            if self._under_way:
                return None
            raise address
        return address

    def _answer(self) -> None:
        while True:
            self._wanted.get()
            try:
                self._found = _first(self._look_up(self._host, self._port))
            except (OSError, UnicodeError) as error:
                # An address that was once right is better than none.
                if not isinstance(self._found, Address):
                    self._found = error if isinstance(error, OSError) else OSError(f"is not a name of a host: {error}")
            self._under_way = False


def _of_the_system(host: str, port: int) -> list[Any]:
    return socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)


def _first(addresses: list[Any]) -> Address:
    family, _, _, _, address = addresses[0]
    return Address(family, address)

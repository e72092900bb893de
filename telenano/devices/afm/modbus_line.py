"""The connection to an instrument over TCP, which never waits, and the timeouts of its drivers."""

import errno
import select
import socket
from collections.abc import Callable
from typing import Any, Protocol

from telenano.devices.afm.host_address import HostAddress
from telenano.extend.instruments import DeviceError

_MS = 1_000_000
LOST_NS = 50 * _MS
RETRY_NS = 500 * _MS
# Time limit of a step of the handshake: writing a setting to flash is slow.
STEP_NS = 1000 * _MS
# Time limit of a name server; with the usual settings the system gives up after ten seconds.
NAME_NS = 15_000 * _MS
_READ_BYTES = 4096


class Line(Protocol):
    """A connection that never waits; each method but `close` raises OSError when the connection is gone.

    `resolved`: whether the address of the device is known, so that connecting has begun.
    """

    @property
    def resolved(self) -> bool: ...

    def ready(self) -> bool:
        """Return whether the connection is made."""

    def send(self, request: bytes) -> None: ...

    def receive(self) -> bytes:
        """Return the bytes that have come, without waiting."""

    def close(self) -> None: ...


Connect = Callable[[str, int], Line]


class TcpLine:
    """A TCP connection to a device, which waits neither for the device nor for its address."""

    def __init__(self, place: HostAddress) -> None:
        """Prepare a connection, which `ready` begins as soon as the address is known."""
        self._place = place
        self._socket: Any = None
        self._connected = False

    @property
    def resolved(self) -> bool:
        return self._socket is not None

    def _connect(self, family: int, address: Any) -> None:
        self._socket = made = socket.socket(family, socket.SOCK_STREAM)
        made.setblocking(False)
        # A request is one small segment, and the next one waits for its answer, so nothing may delay it.
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        failed = made.connect_ex(address)
        self._connected = failed == 0
        if failed not in (0, errno.EINPROGRESS):
            raise OSError(failed, "cannot connect")

    def ready(self) -> bool:
        """Return whether the connection is made; raise OSError also for a name that is not known."""
        if self._socket is None:
            address = self._place.poll()
            if address is None:
                return False
            self._connect(*address)
        if not self._connected and select.select([], [self._socket], [], 0)[1]:
            failed = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if failed:
                raise OSError(failed, errno.errorcode.get(failed, "cannot connect"))
            self._connected = True
        return self._connected

    def send(self, request: bytes) -> None:
        if self._socket.send(request) != len(request):
            raise OSError(errno.EAGAIN, "the device takes no more bytes")

    def receive(self) -> bytes:
        """Return the bytes that have come, without waiting."""
        try:
            received: bytes = self._socket.recv(_READ_BYTES)
        except BlockingIOError:
            return b""
        if not received:
            raise OSError(errno.ECONNRESET, "the device has closed the connection")
        return received

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()


class TcpConnector:
    """Makes the connections to devices, one after the other, and keeps their addresses in between."""

    def __init__(self) -> None:
        self._places: dict[tuple[str, int], HostAddress] = {}

    def __call__(self, host: str, port: int) -> TcpLine:
        """Return a line to a host, given by address or name, that begins to connect."""
        place = self._places.get((host, port))
        if place is None:
            place = self._places[host, port] = HostAddress(host, port)
        else:
            # The device may have another address at the next attempt.
            place.renew()
        return TcpLine(place)


def continue_connecting(line: Line, now_ns: int, begun_ns: int, waiting_ns: int) -> tuple[bool, int]:
    """Return whether a line is connected, and the time since which the device itself (not its name) is awaited [ns].

    Args:
        line: The connection that is being made.
        now_ns: The time [ns].
        begun_ns: The time at which the connection was begun [ns].
        waiting_ns: The second value that the last call returned, at first begun_ns [ns].

    Raises:
        DeviceError: The name is not known, or name server or device have not answered in time.
        OSError: The device refuses the connection.
    """
    try:
        ready = line.ready()
    except OSError as error:
        if line.resolved:
            raise
        raise DeviceError(f"its name is not known: {error.strerror or error}") from error
    if ready:
        return True, waiting_ns
    if not line.resolved:
        if now_ns - begun_ns > NAME_NS:
            raise DeviceError("no name server answers: set network.host to its address")
        return False, now_ns
    if now_ns - waiting_ns > STEP_NS:
        raise DeviceError("does not answer: check address, cable and firewall")
    return False, waiting_ns

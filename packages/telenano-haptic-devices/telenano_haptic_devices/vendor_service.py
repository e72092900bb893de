"""A vendor's service that a driver talks to by WebSocket, for wires in the process of a servo."""

import contextlib
import select
import socket
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from telenano.extend.hands import DeviceError

NEEDS_WEBSOCKETS = "needs websockets: pip install 'websockets>=15'"
# What an answer may take [s].
ANSWER_S = 0.5
# Waiting is divided into these looks: a process that stood still as a whole has missed one of them.
_LOOKS = 5
# A service that has more to read at once than this never ends.
_MOST_READS = 64
T = TypeVar("T")


class VendorService(NamedTuple):
    """A service in words: its name, its device, the key of its address, a usual one, its format, and how it starts.

    open_s: what finding it may take [s].
    """

    name: str
    device: str
    setting: str
    usual: str
    format: str
    start: str
    open_s: float = 3.0


class Conversation(Generic[T]):
    """A WebSocket to a service on a plain socket: what is sent and received takes no thread and no event loop.

    Args:
        about: The service.
        address: Its address, such as ws://127.0.0.1:10001.
        decode: Reads a message; what it raises says that the message is another one.

    Raises:
        DeviceError: Nothing answers at the address.
    """

    def __init__(self, about: VendorService, address: str, decode: Callable[[bytes], T]) -> None:
        try:
            from websockets.client import ClientProtocol
            from websockets.exceptions import InvalidHandshake, InvalidURI
            from websockets.uri import parse_uri
        except ImportError as error:
            raise DeviceError(f"{about.device} {NEEDS_WEBSOCKETS}") from error
        self._about, self._service, self._decode = about, address, decode
        try:
            uri = parse_uri(address)
        except InvalidURI as error:
            raise DeviceError(f"{about.setting}: {address!r} is no address such as {about.usual}") from error
        try:
            self._socket = socket.create_connection((uri.host, uri.port), timeout=about.open_s)
        except OSError as error:
            raise DeviceError(f"no {about.name} answers at {address} ({error}): {about.start}") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._protocol = ClientProtocol(uri, max_size=2**22)
        self._messages: list[bytes] = []
        self._protocol.send_request(self._protocol.connect())
        try:
            self._flush()
            while self._protocol.state.name == "CONNECTING":
                self._receive()
            if self._protocol.handshake_exc is not None:
                raise self._protocol.handshake_exc
        except (DeviceError, InvalidHandshake) as error:
            self.close()
            raise DeviceError(f"what answers at {address} is no {about.name}: {error}") from error

    def send(self, message: bytes) -> None:
        if self._protocol.state.name != "OPEN":
            raise DeviceError(f"{self._service}: the service has closed the connection: {self._about.start}")
        self._protocol.send_text(message)
        self._flush()

    def wait(self, patience_s: float = ANSWER_S) -> None:
        """Wait until there is a message.

        Raises:
            DeviceError: The service is gone or silent.
        """
        self._socket.settimeout(patience_s / _LOOKS)
        looks = 0
        while not self._messages:
            looks = 0 if self._receive() else looks + 1
            if looks == _LOOKS:
                raise DeviceError(f"{self._service}: the service has been silent for {patience_s:g} s")

    def receive(self, patience_s: float = ANSWER_S) -> T:
        """Return the next message.

        Raises:
            DeviceError: The service is gone, silent, or says what cannot be read.
        """
        self.wait(patience_s)
        text = self._messages.pop(0)
        try:
            return self._decode(text)
        except ValueError as error:
            unknown = f"the service sent a message that does not fit {self._about.format}: {error}"
            raise DeviceError(f"{self._service}: {unknown}") from error

    def drop(self, keep: int = 0) -> int:
        """Drop the messages that have come, but the newest `keep`, without waiting; return how many they were.

        Raises:
            DeviceError: The service is gone, or sends without end.
        """
        for _ in range(_MOST_READS):
            if not select.select([self._socket], [], [], 0)[0]:
                break
            self._receive()
        else:
            raise DeviceError(f"{self._service}: the service sends faster than it is read: end other programs of it")
        dropped = max(0, len(self._messages) - keep)
        del self._messages[:dropped]
        return dropped

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._socket.close()

    def _flush(self) -> None:
        try:
            for data in self._protocol.data_to_send():
                if data:
                    self._socket.sendall(data)
        except OSError as error:
            raise DeviceError(f"{self._service}: the service has closed the connection: {self._about.start}") from error

    def _receive(self) -> bool:
        """Take what comes in the time of a look; False if nothing does."""
        from websockets.frames import Frame, Opcode

        try:
            data = self._socket.recv(65_536)
        except TimeoutError:
            return False
        except OSError as error:
            raise DeviceError(f"{self._service}: the service has closed the connection ({error})") from error
        if not data:
            raise DeviceError(f"{self._service}: the service has closed the connection: {self._about.start}")
        self._protocol.receive_data(data)
        for event in self._protocol.events_received():
            if isinstance(event, Frame):
                if event.opcode is Opcode.CLOSE:
                    raise DeviceError(f"{self._service}: the service has ended the session")
                if event.opcode in (Opcode.TEXT, Opcode.BINARY):
                    self._messages.append(bytes(event.data))
        # Pongs and the answer to a close
        self._flush()
        return True

"""The WebSocket conversation with a vendor's service, for wires in the process of a servo."""

import contextlib
import select
import socket
from collections.abc import Callable
from typing import Generic, NamedTuple, TypeVar

from telenano.extend.hands import DeviceError
from telenano.runtime import StructuredLog

NEEDS_WEBSOCKETS = "needs websockets: pip install 'websockets>=15'"
# Time limit of an answer [s].
ANSWER_S = 0.5
# A wait is divided into this many looks, because a stall of the whole process costs only one of them.
_LOOKS = 5
# The largest number of reads at once; a service with more to read sends without end.
_MOST_READS = 64
# Excess of answers with unrequested messages over answers without them that is no accident.
_MOST_UNASKED = 50
T = TypeVar("T")


class VendorService(NamedTuple):
    """Texts about a service: name, device, key of its address, usual address, format, and advice for starting it.

    open_s: time limit of the connection [s].
    """

    name: str
    device: str
    setting: str
    usual: str
    format: str
    start: str
    open_s: float = 3.0


class Conversation(Generic[T]):
    """A WebSocket to a service on a plain socket, without a thread and without an event loop.

    Args:
        about: The service.
        address: Its address, such as ws://127.0.0.1:10001.
        decode: The function that decodes a message; its ValueError means that the message has another format.

    Raises:
        DeviceError: No such service answers at the address, or websockets is not installed.
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
            raise DeviceError(f"{about.setting}: {address!r} is not an address such as {about.usual}") from error
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
            DeviceError: The service is gone or silent, or the message cannot be decoded.
        """
        self.wait(patience_s)
        text = self._messages.pop(0)
        try:
            return self._decode(text)
        except ValueError as error:
            unknown = f"the service sent a message that does not fit {self._about.format}: {error}"
            raise DeviceError(f"{self._service}: {unknown}") from error

    def drop(self, keep: int = 0) -> int:
        """Drop the messages that have come except the newest `keep`, without waiting; return the number dropped.

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
        """Receive bytes within the time of a look; return False if none come."""
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
        # This sends pongs and the answer to a close.
        self._flush()
        return True


class Exchange(Generic[T]):
    """Requests to a service that sends one message for each one that it receives, without time or number.

    Messages that come before the request, or before a newer message, were not requested: they are dropped and counted,
    and a service that keeps sending them is lost.

    Args:
        conversation: The conversation with the service.
        name: The name of the service in errors.
        now_ns: The monotonic clock [ns].
    """

    def __init__(self, conversation: Conversation[T], name: str, now_ns: Callable[[], int]) -> None:
        self._conversation, self._name, self._now_ns = conversation, name, now_ns
        self._sent_ns = now_ns()
        # Number of unrequested messages; and the excess of answers with such messages over answers without.
        self.unasked = self._unasked_lately = 0

    def ask(self, request: bytes, patience_s: float) -> tuple[T, int]:
        """Return the answer to a request, and the earliest time at which its content can have been taken [ns].

        Raises:
            DeviceError: The service is gone, silent for `patience_s` [s], or keeps sending unrequested messages.
        """
        unasked = self._conversation.drop()
        # The content is taken between sending and receipt, so the time of sending bounds its age.
        before_ns, self._sent_ns = self._sent_ns, self._now_ns()
        self._conversation.send(request)
        self._conversation.wait(patience_s)
        self._count(unasked + self._conversation.drop(keep=1))
        # With unrequested messages about, this may be the answer to the previous request.
        taken_ns = before_ns if self._unasked_lately else self._sent_ns
        return self._conversation.receive(), taken_ns

    def _count(self, unasked: int) -> None:
        if unasked and not self.unasked:
            StructuredLog("servo").warning(f"{self._name} sends messages that were not requested")
        self.unasked += unasked
        self._unasked_lately = max(0, self._unasked_lately + (1 if unasked else -1))
        if self._unasked_lately > _MOST_UNASKED:
            raise DeviceError(
                f"{self._name} has sent {self.unasked} messages that were not requested, and "
                "continues: end other programs that use the device, or update the service"
            )

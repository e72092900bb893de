"""A transport that a stranger could have written from docs/extending.md: samples over plain UDP, for a test."""

import contextlib
import socket
import time
from collections.abc import Sequence
from typing import Any

from pydantic import Field

from telenano.runtime import LinkEnds, LinkTransport, Subscriber, Transport, ZmqPublisher
from telenano.settings import Settings


class RadioSettings(Settings):
    """The section `link` of a site file with `transport: my_radio`."""

    transport: str
    port: int = Field(ge=1, le=65535)


MY_RADIO = LinkTransport(RadioSettings, ends="radio_transport:open_ends")


class Radio:
    """One end, which sends every sample of the loop and takes those of the other one."""

    shared = False
    drained = True
    due_ns = 1 << 62
    last_error = ""

    def __init__(self, reader: Subscriber, own: tuple[str, int], other: tuple[str, int]) -> None:
        self.trackers: dict[tuple[str, str], Any] = {}
        self.rejected: dict[str, int] = {}
        self._reader, self._other = reader, other
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind(own)
        except OSError:
            self._socket.close()
            raise
        self.descriptor = self._socket.fileno()

    def carry(self, topic: str, payload: bytes) -> None:
        if topic.startswith("teleop/"):
            self._socket.sendto(topic.encode() + b" " + payload, self._other)

    def receive(self, *, signalled: bool = False) -> list[Any]:
        waiting = []
        with contextlib.suppress(BlockingIOError):
            while len(waiting) < 64:
                topic, _, payload = self._socket.recv(4096).partition(b" ")
                waiting.append(([topic, payload], time.time_ns()))
        return self._reader.take(waiting)

    def input_health(self) -> tuple[()]:
        return ()

    # what the network asks of an end that takes part in it

    sockets = ()

    def process_events(self) -> bool:
        return False

    def take_events(self) -> list[Any]:
        return []

    def apply_permissions(self) -> None: ...

    def close(self) -> None:
        self._socket.close()


def open_ends(
    key: str, network: Transport, outgoing: ZmqPublisher, reports: ZmqPublisher, readers: Sequence[Subscriber]
) -> LinkEnds:
    settings = network.book.link.read(RadioSettings)
    is_master = key.endswith("@master")
    reader = network.reader_of("slave" if is_master else "master", readers)
    if reader is None:
        return LinkEnds()
    own, other = ("127.0.0.1", settings.port), ("127.0.0.1", settings.port + 1)
    radio = Radio(reader, *((own, other) if is_master else (other, own)))
    network.look_after(radio)
    return LinkEnds([radio], carry=radio.carry)

"""A transport as an outside developer could write it from docs/extending.md: samples over plain UDP, for a test."""

import contextlib
import socket
import time
from typing import Any

from pydantic import Field

from telenano.runtime import LinkSide, LinkTransport
from telenano.settings import Settings


class RadioSettings(Settings):
    """The section `link` of a site file with `transport: my_radio`."""

    transport: str
    port: int = Field(ge=1, le=65535)


class Radio:
    """One end, which sends every sample of the loop and receives those of the other end."""

    shared = False
    drained = True
    due_ns = 1 << 62
    last_error = ""

    def __init__(self, side: LinkSide, own: tuple[str, int], other: tuple[str, int]) -> None:
        self.trackers: dict[tuple[str, str], Any] = {}
        self.rejected: dict[str, int] = {}
        self._reader, self._other = side.reader, other
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

    def close(self) -> None:
        self._socket.close()


class MyRadio(LinkTransport):
    """The transport; every process reads its settings."""

    settings = RadioSettings

    def open_end(self, side: LinkSide) -> None:
        port = side.book.link.read(RadioSettings).port
        own, other = ("127.0.0.1", port), ("127.0.0.1", port + 1)
        radio = Radio(side, *((own, other) if side.is_master else (other, own)))
        side.opened(radio, carry=radio.carry, close=radio.close)


MY_RADIO = MyRadio()

"""A page of a running rig without a browser: it sends what a test wants and not what the page of a person shows."""

from contextlib import ExitStack, suppress
from typing import Any
from urllib.parse import urlsplit

import msgpack
from websockets.sync.client import connect


class Client:
    """A page that sends what its person wants and not what it shows."""

    def __init__(self, stack: ExitStack, address: str) -> None:
        parts = urlsplit(address)
        origin: Any = f"http://{parts.netloc}"
        self.socket = stack.enter_context(connect(f"ws://{parts.netloc}/bus", origin=origin, max_size=None))
        self.send(k="hello", protocol=1, token=parts.fragment)
        self.me = self.take("snapshot")["me"]

    def send(self, **frame: Any) -> None:
        self.socket.send(msgpack.packb(frame))

    def take(self, kind: str) -> dict[str, Any]:
        while True:
            found: dict[str, Any] = msgpack.unpackb(self.socket.recv(10.0), strict_map_key=False)
            if found["k"] == kind:
                return found

    def here(self) -> None:
        """Say that it is there, and read what has come: a page that reads nothing is closed."""
        self.send(k="here")
        with suppress(TimeoutError):
            while True:
                self.socket.recv(0)

    def ask(self, **frame: Any) -> dict[str, Any]:
        self.send(id="asked", **frame)
        return self.take("answer")

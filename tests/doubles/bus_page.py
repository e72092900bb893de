"""The web socket side of a page of the server, over the test client of the web framework."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Any

import msgpack

from telenano.serving.access import Access

ACCESS = Access("operator-token-0123", "observer-token-0123", hosts=("testserver",), networks=("127.0.0.0/8",))
HEADERS = {"origin": "http://testserver"}


class BusPage:
    """A page that stores every byte that it receives."""

    def __init__(self, stack: ExitStack, client: Any, token: str = ACCESS.operator_token, **hello: Any) -> None:
        self.traffic = b""
        self.socket = stack.enter_context(client.websocket_connect("/bus", headers=HEADERS))
        self.send({"k": "hello", "token": token, "protocol": 1, **hello})

    def send(self, fields: Mapping[str, Any]) -> None:
        self.socket.send_bytes(msgpack.packb(fields))

    def take_where(self, is_wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        """Return the next frame for which `is_wanted` is true."""
        while True:
            data = self.socket.receive_bytes()
            self.traffic += data
            frame: dict[str, Any] = msgpack.unpackb(data)
            if is_wanted(frame):
                return frame

    def take(self, kind: str) -> dict[str, Any]:
        return self.take_where(lambda frame: frame["k"] == kind)

    def ask(self, **fields: Any) -> dict[str, Any]:
        self.send({"id": "a-1", **fields})
        return self.take("answer")

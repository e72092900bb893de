"""A source without a rig for the page's server: a test adds the messages that the server shows."""

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

from services.viz_node.feed import SeenMessage
from services.viz_node.source import NoTransport


class MadeSource(NoTransport):
    """Returns each message in `waiting` once; the server may read while the test adds messages."""

    def __init__(self, name: str = "test") -> None:
        self.name = name
        self.waiting: deque[SeenMessage] = deque()

    def poll(self, *, watched: bool) -> Iterable[SeenMessage]:
        return [self.waiting.popleft() for _ in range(len(self.waiting))]

    def about(self) -> Mapping[str, Any]:
        return {"kind": "live", "name": self.name}

    def close(self) -> None:
        pass

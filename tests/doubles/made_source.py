"""A rig without nodes for the server of the page: a test puts in each message, and the server takes it from there."""

from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any

from services.viz_node.feed import SeenMessage
from services.viz_node.source import NoTransport


class MadeSource(NoTransport):
    """Shows what is in `waiting`, once; the server may take from it while the test fills it."""

    def __init__(self, name: str = "test") -> None:
        self.name = name
        self.waiting: deque[SeenMessage] = deque()

    def poll(self, *, watched: bool) -> Iterable[SeenMessage]:
        return [self.waiting.popleft() for _ in range(len(self.waiting))]

    def about(self) -> Mapping[str, Any]:
        return {"kind": "live", "name": self.name}

    def close(self) -> None:
        pass

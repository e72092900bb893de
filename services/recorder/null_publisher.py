"""A node without a place on the bus: what it says goes to whoever runs it."""

from services.runtime.bus import Publisher
from services.runtime.clock import Clock

OBSERVER = "record@master"


class NullPublisher(Publisher):
    """A publisher that numbers and checks as any other, and keeps the newest messages instead of sending them.

    An observer that comes and goes has no endpoint in the site file, and nobody is to wait for it.
    """

    def __init__(self, clock: Clock, node: str) -> None:
        self.node = node
        self.newest: dict[str, bytes] = {}
        self._clock = clock
        self._sequence = {}

    def send(self, topic: str, payload: bytes) -> None:
        """Keep a message."""
        self.newest[topic] = payload

    def close(self) -> None:
        """There is nothing to close."""

"""A node under test: a virtual clock and a bus that keeps what is published."""

from collections.abc import Iterator
from typing import Any

import pytest

from proto import TOPICS, encode
from proto.messages import Message
from services.runtime.bus import Received
from services.runtime.clock import VirtualClock
from services.runtime.log import StructuredLog
from services.runtime.node import NodeContext
from services.runtime.sequence import Arrival


class Bench:
    """The world of one node: what it publishes is kept, what it hears is made here."""

    def __init__(self, key: str) -> None:
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=10**18)
        self.sent: list[tuple[str, Message]] = []
        self._sequence: dict[tuple[str, str], int] = {}
        self.context = NodeContext(key, self.clock, self, StructuredLog(key))

    def publish(self, topic: str, **fields: Any) -> Message:
        message = self.make(topic, self.context.key, **fields)
        self.sent.append((topic, message))
        return message

    def receive(self) -> Iterator[Received]:
        return iter(())

    def wait(self, deadline_ns: int) -> None:
        self.clock.advance_ns(max(0, deadline_ns - self.clock.monotonic_ns()))

    def make(self, topic: str, src: str, **fields: Any) -> Message:
        """Build a message with the next number of its source."""
        seq = self._sequence.get((topic, src), 0)
        self._sequence[topic, src] = seq + 1
        model = TOPICS[topic].model
        header = {"seq": seq, "t_ns": self.clock.now_ns(), "src": src, "v": model.version}
        return model.model_validate({**header, **fields})

    def heard(self, topic: str, src: str, **fields: Any) -> Received:
        """Give a message of another node as the node would receive it now."""
        message = self.make(topic, src, **fields)
        return Received(topic, message, encode(message), self.clock.now_ns(), Arrival.NEXT)

    def take(self, topic: str) -> list[Any]:
        """Give and forget what was published on a topic."""
        taken = [message for name, message in self.sent if name == topic]
        self.sent = [(name, message) for name, message in self.sent if name != topic]
        return taken

    def advance_ms(self, duration_ms: float) -> None:
        self.clock.advance_ns(round(duration_ms * 1e6))


@pytest.fixture
def bench_of() -> type[Bench]:
    """Give the class of benches; call it with node@site."""
    return Bench

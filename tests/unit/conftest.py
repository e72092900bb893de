"""A node under test: a virtual clock and a bus that keeps what is published. And recordings to read."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from recorder_samples import EPOCH_NS, MILLISECOND_NS, NODE, haptic_state, teleop_forward

from proto import TOPICS, encode
from proto.messages import Message
from proto.ranges import limited
from proto.sequence import Arrival
from recording.writer import RecordingWriter
from services.recorder.config import RecorderConfig
from services.runtime.bus.bus import Received
from services.runtime.loop.log import StructuredLog
from services.runtime.loop.node import NodeContext
from tests.doubles.virtual_clock import VirtualClock


class Bench:
    """The world of one node: what it publishes is kept, what it receives is made here."""

    def __init__(self, key: str) -> None:
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=10**18)
        self.sent: list[tuple[str, Message]] = []
        self._sequence: dict[tuple[str, str], int] = {}
        self.context = NodeContext(key, self.clock, self, StructuredLog(key))

    def publish(self, topic: str, **fields: Any) -> Message:
        message = self._made(limited, topic, self.context.key, fields)
        self.sent.append((topic, message))
        return message

    def receive(self) -> Iterator[Received]:
        return iter(())

    def run_deferred(self) -> None:
        """Run the tasks that the node has deferred."""
        while (task := self.context.deferred.take_turn()) is not None:
            task()

    def wait(self, deadline_ns: int) -> None:
        self.clock.advance_ns(max(0, deadline_ns - self.clock.monotonic_ns()))

    def make(self, topic: str, src: str, **fields: Any) -> Message:
        """Build a message with the next number of its source."""
        return self._made(lambda model, whole: model.model_validate(whole), topic, src, fields)

    def _made(self, build: Callable[..., Message], topic: str, src: str, fields: dict[str, Any]) -> Message:
        seq = self._sequence.get((topic, src), 0)
        self._sequence[topic, src] = seq + 1
        model = TOPICS[topic].model
        header = {"seq": seq, "t_ns": self.clock.now_ns(), "src": src, "v": model.version_of(fields)}
        return build(model, {**header, **fields})

    def received(self, topic: str, src: str, **fields: Any) -> Received:
        """Return a message of another node as the node would receive it now."""
        message = self.make(topic, src, **fields)
        return Received(topic, message, encode(message), self.clock.now_ns(), Arrival.NEXT)

    def link_delay(self, direction: str, delay_ns: int, hand_t_ns: int = 0, **changes: int) -> Received:
        """Return what the link tells a reader of its delay."""
        src = "delay_node@" + self.context.key.partition("@")[2]
        fields = {"direction": direction, "hand_t_ns": hand_t_ns, "delay_ns": delay_ns}
        return self.received("link/delay", src, **{**fields, "transit_ns": 0, "clock_ahead_ns": 0, **changes})

    def take(self, topic: str) -> list[Any]:
        """Return and remove what was published on a topic."""
        taken = [message for name, message in self.sent if name == topic]
        self.sent = [(name, message) for name, message in self.sent if name != topic]
        return taken

    def advance_ms(self, duration_ms: float) -> None:
        self.clock.advance_ns(round(duration_ms * 1e6))


@pytest.fixture
def bench_of() -> type[Bench]:
    """Return the class of benches; call it with node@site."""
    return Bench


@pytest.fixture
def config(tmp_path: Path) -> RecorderConfig:
    return RecorderConfig(directory=tmp_path)


@pytest.fixture
def make_file(tmp_path: Path) -> Callable[..., Path]:
    """Write a recording of two topics, the second one received behind the link, in chunks of 10 ms."""

    def make(messages: int = 40, *, finish: bool = True, **settings: Any) -> Path:
        writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path, **settings))
        writer.attach("site.yaml", "application/yaml", b"nodes: {}\n", EPOCH_NS)
        writer.add_metadata("versions", {"python": "3"})
        hand = writer.channel("haptic/state", "haptic_node@master", "master")
        far = writer.channel("teleop/forward", "controller@master", "slave")
        for seq in range(messages):
            log_ns = EPOCH_NS + seq * MILLISECOND_NS
            writer.write(hand, log_ns + 100, log_ns, seq, encode(haptic_state(seq)))
            writer.write(far, log_ns + 200, log_ns, seq, encode(teleop_forward(seq)))
            if seq % 10 == 9:
                writer.flush()
        if finish:
            writer.finish()
        else:
            writer.flush()
            writer._stream.close()
        return writer.path

    return make

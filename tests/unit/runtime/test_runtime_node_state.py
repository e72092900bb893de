"""The state of a node as bytes, and a node that was just built put into it."""

from collections import deque
from types import SimpleNamespace
from typing import Any, NamedTuple

import msgpack
import numpy as np
import pytest

from proto.errors import RecordingError
from proto.messages import HapticCommand
from services.controller.law import HandSample
from services.runtime.loop.clock import VirtualClock
from services.runtime.loop.deadlines import PeriodicDeadline
from services.runtime.loop.log import StructuredLog
from services.runtime.loop.node import Node, NodeContext
from services.runtime.loop.node_state import FindInput, StateSnapshot, restore

COMMAND = HapticCommand(
    seq=3, t_ns=4, src="a@b", v=1, mode="off", position_m=(0.0, -0.0, 1e-300), velocity_m_per_s=(0.0, 0.0, 0.0),
    force_n=(0.0, 0.0, 0.0), hand_seq=1, hand_t_ns=2,
)  # fmt: skip


class Stranger(NamedTuple):
    """A kind of value that is not of the project's packages."""

    value: float


class Engine:
    """A part whose state has a form of its own: the names of messages that it holds."""

    __module__ = "services.delay_node.engine"

    def __init__(self) -> None:
        self.held: list[tuple[str, str, int, bytes]] = []

    def capture_state(self) -> Any:
        return [(*name, len(payload)) for *name, payload in self.held]

    def restore_state(self, state: Any, find: FindInput) -> None:
        self.held = [(topic, src, seq, find(topic, src, seq, 0, size)) for topic, src, seq, size in state]


class Stateful(Node):
    inputs = ()

    def __init__(self, clock: VirtualClock) -> None:
        bus: Any = SimpleNamespace(publish=None)
        super().__init__(NodeContext("n@s", clock, bus, StructuredLog("n@s")))
        self.grid = PeriodicDeadline(clock.monotonic_ns(), 1000)
        self.table = np.arange(3.0)
        self.sample: Any = None
        self.command: HapticCommand | None = None
        self.reported: Any = ("off", 1)
        self.seen: set[str] = set()
        self.last: deque[Any] = deque(maxlen=3)
        self.engine = Engine()
        self.handle: Any = None

    def on_message(self, received: Any) -> None: ...

    def on_deadline(self, now_ns: int) -> None: ...

    def make_safe(self) -> None: ...


def test_a_node_goes_on_from_the_state_of_another() -> None:
    node = Stateful(VirtualClock(5000))
    snapshot = StateSnapshot(node)
    node.grid.advance(9100)
    node.sample = HandSample(1.0 / 3.0, -0.0, float("inf"), True)
    node.command = COMMAND
    node.reported = ("force", (2, None))
    node.seen.update({"b@s", "a@s"})
    node.last.extend([1, (2, "b"), HandSample(0.0, 1.0, 2.0, False), COMMAND])
    node.engine.held = [("afm/state", "a@b", 4, b"xyz"), ("afm/state", "a@b", 5, b"1")]
    node.steps = 7
    other = Stateful(VirtualClock(0))
    state = snapshot.capture()
    found = {4: b"xyz"}
    restore(other, state, lambda topic, src, seq, arrived_ns, size_bytes: found.get(seq, bytes(size_bytes)))
    assert (other.grid.deadline_ns, other.grid.overruns) == (10_000, 3)
    assert type(other.sample) is HandSample
    assert repr(other.sample) == repr(node.sample)
    assert other.command == COMMAND
    assert other.reported == ("force", (2, None))
    assert other.seen == {"a@s", "b@s"}
    assert other.last == node.last
    assert other.last.maxlen == 3
    assert type(other.last[1]) is HandSample
    assert other.engine.held == [("afm/state", "a@b", 4, b"xyz"), ("afm/state", "a@b", 5, b"\0")]
    assert other.steps == 7
    assert other.clock is not node.clock
    # what was not replaced is built again, not sent
    assert "table" not in msgpack.unpackb(state)


def test_an_array_comes_back_bit_by_bit_and_can_be_written_to() -> None:
    node, other = Stateful(VirtualClock()), Stateful(VirtualClock())
    snapshot = StateSnapshot(node)
    node.sample = (np.array([[0.1, -0.0], [np.pi, 5e-324]]), True)
    restore(other, snapshot.capture())
    assert other.sample[0].tobytes() == node.sample[0].tobytes()
    assert other.sample[0].shape == (2, 2)
    other.sample[0][0, 0] = 1.0


@pytest.mark.parametrize("value", [object(), Stranger(1.0), lambda: None, 2**70, bytes(10**6)])
def test_what_has_no_form_gives_no_state_and_disturbs_nothing(value: object) -> None:
    node = Stateful(VirtualClock())
    snapshot = StateSnapshot(node)
    assert snapshot.capture()
    node.handle = value
    assert snapshot.capture() == b""


@pytest.mark.parametrize(
    "state",
    [
        b"",
        b"\xc1",
        msgpack.packb({"sample": ["tuple", "os:system", ["true"]]}),
        msgpack.packb({"sample": ["tuple", "services.runtime.loop.main:run_node", []]}),
        msgpack.packb({"sample": ["tuple", "services.runtime.loop.clock:SystemClock", []]}),
        msgpack.packb({"sample": ["tuple", "services.controller.law:HandSample", [1.0]]}),
        # the last field of this class has a default, which must not stand for a value that was not recorded
        msgpack.packb({"sample": ["tuple", "services.haptic_node.safety:SafetyInputs", [1, 0.0, 0.0, 0.0, *3 * [0]]]}),
        msgpack.packb({"missing": ["parts", {}]}),
        msgpack.packb({"sample": ["unknown", []]}),
        msgpack.packb({"sample": []}),
        msgpack.packb([1]),
    ],
)
def test_a_state_of_something_else_is_refused(state: bytes) -> None:
    with pytest.raises(RecordingError, match="its state in the journal does not fit this code"):
        restore(Stateful(VirtualClock()), state)

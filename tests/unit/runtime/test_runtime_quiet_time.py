"""Reports of a node of the loop: after a tick has passed, one at a time, and never for ever."""

from itertools import pairwise
from typing import Any, ClassVar

import pytest

from proto import TOPICS
from proto.contract import examples
from proto.messages import InputHealth, Message
from proto.nodes import START_ORDER
from proto.ranges import limited
from proto.sequence import Arrival
from services.runtime.bus import ConnectionEvent, Received
from services.runtime.clock import VirtualClock
from services.runtime.log import StructuredLog
from services.runtime.node import Node, NodeContext, NodeLoop
from services.runtime.quiet_time import HEALTH_PERIOD_NS, OWN_DEADLINE, PATIENCE_NS, QuietTime
from services.runtime.realtime import RealtimeStatus

MS = 1_000_000
SETTLE_NS = 300_000
# of a tick: when the first message of it comes to this node, and the last one
FIRST_NS, LAST_NS = 100_000, 400_000
MESSAGES = {topic: examples(TOPICS[topic])["ordinary"] for topic in ("teleop/forward", "teleop/backward")}


class Part(Node):
    """A node in the middle of the loop."""

    inputs: ClassVar[tuple[str, ...]] = ("teleop/forward", "teleop/backward")
    journalled = True
    last_of_tick = "teleop/backward"
    settle_ns = SETTLE_NS

    def on_message(self, received: Received) -> None:
        self.steps += 1

    def on_deadline(self, now_ns: int) -> None:
        raise AssertionError("it has none")

    def make_safe(self) -> None:
        """Do nothing."""


class LoopBus:
    """A bus in virtual time on which a tick passes each millisecond, while there are any."""

    def __init__(self, clock: VirtualClock, key: str, ticks_until_ns: int) -> None:
        self.clock, self._key, self._until_ns = clock, key, ticks_until_ns
        self.sent: list[tuple[int, str]] = []
        self._next = self._after(clock.monotonic_ns())

    def _after(self, now_ns: int) -> tuple[int, str]:
        tick_ns = now_ns - now_ns % MS
        times = [(tick_ns + n * MS + at_ns, topic) for n in (0, 1) for at_ns, topic in self._course]
        return next(entry for entry in times if entry[0] > now_ns)

    _course: ClassVar[tuple[tuple[int, str], ...]] = ((FIRST_NS, "teleop/forward"), (LAST_NS, "teleop/backward"))

    def publish(self, topic: str, **fields: Any) -> Message:
        self.sent.append((self.clock.monotonic_ns(), topic))
        model = TOPICS[topic].model
        header = {"seq": len(self.sent), "t_ns": self.clock.now_ns(), "src": self._key, "v": model.version}
        return limited(model, {**header, **fields})

    def wait(self, deadline_ns: int) -> None:
        next_ns = self._next[0] if self._next[0] < self._until_ns else deadline_ns
        self.clock.advance_ns(max(0, min(next_ns, deadline_ns) - self.clock.monotonic_ns()))

    def receive(self) -> list[Received]:
        now_ns = self.clock.monotonic_ns()
        at_ns, topic = self._next
        if at_ns > now_ns or at_ns >= self._until_ns:
            return []
        self._next = self._after(at_ns)
        return [Received(topic, MESSAGES[topic], b"", self.clock.now_ns(), Arrival.NEXT)]

    def input_health(self) -> tuple[InputHealth, ...]:
        return ()

    def sequence_numbers(self) -> dict[str, int]:
        return {}

    def rejections(self) -> tuple[dict[str, int], str]:
        return {}, ""

    def drain(self) -> None:
        """Do nothing: nothing waits."""

    def process_events(self, *, now: bool = False) -> list[ConnectionEvent]:
        return []


def reports(key: str, *, ticks_until_ns: int = 2**62, for_ns: int = 3000 * MS) -> list[tuple[int, str]]:
    """Return time [ns] and topic of what a node reports of itself."""
    clock = VirtualClock(start_ns=7_777_777, epoch_offset_ns=10**18)
    bus = LoopBus(clock, key, ticks_until_ns)
    node = Part(NodeContext(key, clock, bus, StructuredLog(key)))
    loop = NodeLoop(node, bus, RealtimeStatus(fifo=False, memory_locked=False))
    while clock.monotonic_ns() < for_ns:
        loop.turn()
    return bus.sent


def test_a_report_waits_until_the_tick_has_passed_and_each_has_a_tick_of_its_own() -> None:
    found = reports("controller@slave")
    assert {topic for _, topic in found} == {"node/health", "node/journal"}
    assert {at_ns % MS for at_ns, _ in found} == {LAST_NS + SETTLE_NS}
    assert len({at_ns // MS for at_ns, _ in found}) == len(found)
    health = [at_ns for at_ns, topic in found if topic == "node/health"]
    between = [b - a for a, b in pairwise(health)]
    assert len(health) >= 5
    assert max(between[1:]) <= HEALTH_PERIOD_NS + 2 * MS
    assert max(between) <= HEALTH_PERIOD_NS * 3 // 2


def test_no_two_nodes_of_a_machine_report_in_one_tick() -> None:
    ticks = [{at_ns // MS for at_ns, _ in reports(node) if at_ns > 1000 * MS} for node in START_ORDER]
    assert all(len(found) >= 7 for found in ticks)
    assert sum(map(len, ticks)) == len(set().union(*ticks))


@pytest.mark.parametrize("ticks_until_ns", [0, 1500 * MS])
def test_a_node_whose_loop_stands_still_reports_all_the_same(ticks_until_ns: int) -> None:
    found = reports("controller@slave", ticks_until_ns=ticks_until_ns)
    late = [at_ns for at_ns, topic in found if topic == "node/health" and at_ns > ticks_until_ns + HEALTH_PERIOD_NS]
    assert len(late) >= 2
    assert max(b - a for a, b in pairwise(late)) <= HEALTH_PERIOD_NS + 2 * PATIENCE_NS


def test_a_node_that_paces_the_loop_reports_some_time_after_its_own_deadline() -> None:
    quiet = QuietTime("haptic_node@master", OWN_DEADLINE, SETTLE_NS)
    # the report falls due between two deadlines: the next one is waited for, and then the time of others
    assert quiet.put_off([], 5 * MS, 5 * MS, had_deadline=False) == 5 * MS + PATIENCE_NS
    assert quiet.waits
    assert quiet.put_off([], 6 * MS, 5 * MS + PATIENCE_NS, had_deadline=True) == 6 * MS + SETTLE_NS
    assert quiet.waits
    assert quiet.put_off([], 6 * MS + SETTLE_NS, 6 * MS + SETTLE_NS, had_deadline=False) == 6 * MS + SETTLE_NS
    assert not quiet.waits

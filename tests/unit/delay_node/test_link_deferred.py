"""What the link reports is deferred, a piece at a time, and says what is so when it is sent."""

from pathlib import Path
from typing import Any

import pytest
from recorder_samples import fields_of

from services.delay_node.node import DelayNode
from telenano.runtime.wiring.link_transports import TRAIN
from telenano.settings.link_settings import LinkSettings
from telenano.wire.errors import RefusedError

MS = 1_000_000
SIGNAL = fields_of("teleop/backward", hand_t_ns=1)


class Endpoint:
    """An endpoint at a site: keeps what the link publishes of its own, with the time."""

    def __init__(self, bench: Any, sent: list[tuple[str, int]]) -> None:
        self._bench, self._sent = bench, sent

    def send(self, topic: str, payload: bytes) -> None:
        """Send on what others published."""

    def publish(self, topic: str, **fields: Any) -> Any:
        self._sent.append((topic, self._bench.clock.monotonic_ns()))

    def sequence_numbers(self) -> dict[str, int]:
        return {}


class Link:
    def __init__(self, bench_of: Any) -> None:
        self.bench = bench_of("delay_node@master")
        # of both endpoints and of the link itself, in the order of sending
        self.sent: list[tuple[str, int]] = []
        outlets = (Endpoint(self.bench, self.sent), Endpoint(self.bench, self.sent))
        self.node = DelayNode(self.bench.context, LinkSettings.of({}), *outlets, Path())
        self.node.publish = self.noted

    def noted(self, topic: str, **fields: Any) -> Any:
        self.sent.append((topic, self.bench.clock.monotonic_ns()))

    def tick(self) -> None:
        """Let a tick come back, and time pass until the next one."""
        self.node.on_message(self.bench.received("teleop/backward", "controller@slave", **SIGNAL))
        self.pass_time(MS)

    def pass_time(self, duration_ns: int) -> None:
        clock = self.bench.clock
        end_ns = clock.monotonic_ns() + duration_ns
        while (due_ns := self.node.deadline_ns()) < end_ns:
            clock.advance_ns(max(0, due_ns - clock.monotonic_ns()))
            self.node.on_deadline(clock.monotonic_ns())
        clock.advance_ns(end_ns - clock.monotonic_ns())

    def run_task(self) -> list[str]:
        """Run the next task, and return the topics on which it published."""
        sent = len(self.sent)
        task = self.bench.context.deferred.take_turn()
        assert task is not None
        task()
        return [topic for topic, _ in self.sent[sent:]]


@pytest.fixture
def link(bench_of: Any) -> Link:
    return Link(bench_of)


def test_a_report_is_due_ten_times_a_second_and_each_piece_is_a_task(link: Link) -> None:
    for _ in range(2):
        link.pass_time(100 * MS + 1)
        # nothing in the turn of the deadline
        assert link.sent == []
        # there are no fates, and the forward delay is declared at both sites
        assert [link.run_task() for _ in range(6)] == [
            [], [], ["link/status"], ["link/delay", "link/delay"], ["link/delay"], ["clock/ping"]
        ]  # fmt: skip
        assert not link.bench.context.deferred.has_turns
        link.sent.clear()


def test_fates_are_deferred_when_there_are_enough_and_only_once(link: Link) -> None:
    for _ in range(31):
        link.tick()
    assert not link.bench.context.deferred.has_turns
    for _ in range(5):
        link.tick()
    assert link.sent == []
    assert [link.run_task(), link.run_task()] == [[], ["link/fates"]]
    assert not link.bench.context.deferred.has_turns
    # those of all ticks until then: the count begins anew
    link.tick()
    assert not link.bench.context.deferred.has_turns


def test_a_task_of_the_link_stands_for_what_is_so_when_it_is_run(link: Link) -> None:
    """A delay that was declared meanwhile must not be followed by an older one."""
    declared: list[Any] = []
    link.node.backward.outlet.publish = lambda topic, **fields: declared.append((topic, fields))
    link.pass_time(100 * MS + 1)
    for _ in range(4):
        link.run_task()
    link.node.memory.backward_delay.current = link.node.memory.backward_delay.current._replace(delay_ns=7 * MS)
    declared.clear()
    link.run_task()
    assert [(topic, fields["delay_ns"]) for topic, fields in declared] == [("link/delay", 7 * MS)]


def test_a_train_is_sent_on_command_and_refused_where_there_can_be_none(bench_of: Any) -> None:
    sent = [True, False]
    link = Link(bench_of)
    train = link.bench.received("session/control", "console@master", **_command({TRAIN: True})).message
    with pytest.raises(RefusedError, match="no datagrams cross"):
        link.node.on_control(train)
    link.node._send_train = lambda: sent.pop(0)
    assert "link/network has what the line carried" in link.node.on_control(train)
    with pytest.raises(RefusedError, match="the line is full, or one was sent just before"):
        link.node.on_control(train)
    both = link.bench.received("session/control", "console@master", **_command({TRAIN: True, "seed": 1})).message
    with pytest.raises(RefusedError, match="line"):
        link.node.on_control(both)


def _command(parameters: dict[str, Any]) -> dict[str, Any]:
    return {"id": "1", "command": "set", "target": "delay_node", "parameters": parameters}

"""The loop of a node in virtual time."""

import json
import logging
import os
import select
import signal
from bisect import bisect_right, insort
from collections.abc import Iterator
from operator import itemgetter
from typing import Any, ClassVar

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from telenano.runtime.bus.bus import ConnectionEvent
from telenano.runtime.loop import journal
from telenano.runtime.loop.deadlines import PeriodicDeadline
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.machine import resident_bytes
from telenano.runtime.loop.node import HEALTH_PERIOD_NS, Node, NodeContext
from telenano.runtime.loop.node_loop import NodeLoop, install_stop_signals
from telenano.runtime.loop.realtime import RealtimeStatus
from telenano.testing import VirtualClock
from telenano.testing.filled_messages import examples
from telenano.timing.clock import NEVER_NS
from telenano.wire import Message, compose, encode
from telenano.wire.codec import fields_of
from telenano.wire.ends import read_end
from telenano.wire.errors import ConfigError, RefusedError
from telenano.wire.journal_messages import NodeJournal
from telenano.wire.messages import MAX_TEXT, InputHealth, NodeHealth, SessionControl, SessionEvent
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival
from telenano.wire.topics import TOPICS

MS = 1_000_000
GRANTED = RealtimeStatus(fifo=True, memory_locked=False)


class FakeBus:
    """A bus in virtual time: messages arrive when their time has come, and a wait takes as long as it takes."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.sent: list[Message] = []
        self.coming: list[tuple[int, Received]] = []
        self.refused: dict[str, int] = {}
        self.waits: list[int] = []
        self.oversleep_ns = 0
        self.notices: list[ConnectionEvent] = []
        self.attended: list[bool] = []

    def publish(self, topic: str, **fields: Any) -> Message:
        model = TOPICS[topic].model
        header = {"seq": len(self.sent), "t_ns": self.clock.now_ns(), "src": "n@s", "v": model.version}
        message, _ = compose(topic, {**header, **fields})
        self.sent.append(message)
        return message

    def arrives(self, at_ns: int, topic: str, arrival: Arrival = Arrival.NEXT, **changed: object) -> None:
        fields = fields_of(examples(TOPICS[topic])["ordinary"])
        if topic == "session/control":
            # old commands have expired
            fields["t_ns"] = at_ns + self.clock.epoch_offset_ns
        fields |= changed
        message = msgspec.convert(fields, TOPICS[topic].model)
        insort(self.coming, (at_ns, Received(topic, message, encode(message), at_ns, arrival)), key=itemgetter(0))

    def wait(self, deadline_ns: int) -> None:
        self.waits.append(deadline_ns)
        until = min([deadline_ns, *(at for at, _ in self.coming[:1])])
        if until == deadline_ns:
            until += self.oversleep_ns
        self.clock.advance_ns(max(0, until - self.clock.monotonic_ns()))

    def receive(self) -> Iterator[Received]:
        now = self.clock.monotonic_ns()
        due = bisect_right(self.coming, now, key=itemgetter(0))
        arrived, self.coming = self.coming[:due], self.coming[due:]
        yield from (received for _, received in arrived)

    def input_health(self) -> tuple[InputHealth, ...]:
        return ()

    def sequence_numbers(self) -> dict[str, int]:
        return {"haptic/state": len(self.sent)}

    def rejections(self) -> tuple[dict[str, int], str]:
        return dict(self.refused), "haptic/state: not msgpack" if self.refused else ""

    def process_events(self, *, now: bool = False) -> list[ConnectionEvent]:
        self.attended.append(now)
        turns_of, self.notices = self.notices, []
        return turns_of

    def has_arrived(self) -> bool:
        return any(at <= self.clock.monotonic_ns() for at, _ in self.coming[:1])

    def close(self) -> None:
        self.sent.clear()

    def of(self, model: type[Message]) -> list[Any]:
        return [message for message in self.sent if isinstance(message, model)]


class Probe(Node):
    """A node that writes down what happens to it."""

    inputs: ClassVar[tuple[str, ...]] = ("haptic/state", "session/control")
    commands: ClassVar[tuple[str, ...]] = ("set", "estop")

    def __init__(self, context: NodeContext, period_ns: int = 0) -> None:
        super().__init__(context)
        self.grid = PeriodicDeadline(context.clock.monotonic_ns(), period_ns) if period_ns else None
        self.period_s = period_ns * 1e-9
        self.messages: list[Received] = []
        self.ticks: list[int] = []
        self.carried_out: list[str] = []
        self.made_safe = 0
        self.fails_at: int | None = None

    def on_message(self, received: Received) -> None:
        self.messages.append(received)

    def deadline_ns(self) -> int:
        return self.grid.deadline_ns if self.grid else super().deadline_ns()

    def on_deadline(self, now_ns: int) -> None:
        assert self.grid is not None
        self.ticks.append(now_ns)
        self.steps += 1
        self.grid.advance(now_ns)
        self.overruns = self.grid.overruns
        if len(self.ticks) == self.fails_at:
            raise RuntimeError("driver gone")

    def on_control(self, control: SessionControl) -> str:
        if control.command == "set":
            if "gain" not in control.parameters:
                raise RefusedError(f"set needs gain, not {', '.join(control.parameters)}")
            self.carried_out.append(control.id)
            return f"gain is {control.parameters['gain']}"
        if control.command == "estop":
            raise ConfigError("controller.gain: is missing")
        return super().on_control(control)

    def make_safe(self) -> None:
        self.made_safe += 1


class Rig:
    def __init__(self, period_ns: int = 0, key: str = "controller@master") -> None:
        self.clock = VirtualClock(start_ns=5 * MS, epoch_offset_ns=10**18)
        self.bus = FakeBus(self.clock)
        self.node = Probe(NodeContext(key, self.clock, self.bus, StructuredLog(key)), period_ns)
        self.loop = NodeLoop(self.node, self.bus, GRANTED)

    def run_until(self, t_ns: int) -> None:
        while self.clock.monotonic_ns() < t_ns:
            self.loop.turn()

    def command(self, command: str = "set", target: str = "*", identifier: str = "a", **parameters: Any) -> None:
        fields = {"id": identifier, "command": command, "target": target, "parameters": parameters}
        header = {"seq": 0, "t_ns": self.clock.now_ns(), "src": "launcher@master", "v": 1}
        message = msgspec.convert({**header, **fields}, SessionControl)
        self.bus.coming.append((0, Received("session/control", message, encode(message), 0, Arrival.NEXT)))
        self.loop.turn()

    @property
    def events(self) -> list[SessionEvent]:
        return self.bus.of(SessionEvent)

    @property
    def health(self) -> list[NodeHealth]:
        return self.bus.of(NodeHealth)


# --- the loop ---


def test_deadlines_come_exactly_and_health_twice_a_second() -> None:
    rig = Rig(period_ns=MS)
    rig.run_until(2005 * MS)
    assert rig.node.ticks == [(6 + step) * MS for step in range(2000)]
    times = [(h.t_ns - 10**18) // MS for h in rig.health]
    # the first report comes at once, later ones half a second after the last
    assert times == [5, 505, 1005, 1505, 2005]
    second = rig.health[1]
    assert second.rate_hz == 1000.0
    assert (second.period_s, second.overruns, second.state) == (0.001, 0, "ready")
    assert (second.lateness_p50_s, second.lateness_max_s) == (0.0, 0.0)
    assert (second.realtime, second.memory_locked, second.pid) == (True, False, os.getpid())
    assert second.uptime_s == 0.5
    assert second.memory_bytes > 10**6


@pytest.mark.parametrize("begun_ms", [0, 100_000])
def test_a_process_reports_more_often_at_first_however_long_its_machine_has_run(begun_ms: int) -> None:
    rig = Rig(period_ns=MS)
    rig.clock.advance_ns(begun_ms * MS)
    rig.node.grid = PeriodicDeadline(rig.clock.monotonic_ns(), MS)
    rig.loop = NodeLoop(rig.node, rig.bus, GRANTED, starting_period_ns=100 * MS)
    rig.run_until((begun_ms + 4005) * MS)
    assert [(h.t_ns - 10**18) // MS - begun_ms for h in rig.health] == [*range(5, 3006, 100), 3505, 4005]
    assert {h.rate_hz for h in rig.health[1:]} == {1000.0}


def test_a_process_whose_session_runs_reports_twice_a_second() -> None:
    rig = Rig(period_ns=MS)
    rig.loop = NodeLoop(rig.node, rig.bus, GRANTED, starting_period_ns=100 * MS)
    rig.run_until(1000 * MS)
    rig.node.state = "running"
    rig.run_until(2100 * MS)
    assert [(h.t_ns - 10**18) // MS for h in rig.health] == [*range(5, 1006, 100), 1505, 2005]


def test_a_process_that_runs_reports_as_often_as_at_first_until_it_receives_every_input() -> None:
    rig = Rig(period_ns=MS)
    rig.node.state = "running"
    silent = InputHealth(
        topic="afm/state", src="", received=0, lost=0, gaps=0, repeated=0, restarts=0, age_valid=False, age_s=0.0
    )
    rig.bus.input_health = lambda: (silent,)
    rig.loop = NodeLoop(rig.node, rig.bus, GRANTED, starting_period_ns=100 * MS)
    rig.run_until(300 * MS)
    heard = msgspec.structs.replace(silent, received=1, age_valid=True)
    # a topic without a rate is waited for by nobody
    rig.bus.input_health = lambda: (heard, msgspec.structs.replace(silent, topic="afm/scanline"))
    rig.run_until(1500 * MS)
    assert [(h.t_ns - 10**18) // MS for h in rig.health] == [5, 105, 205, 305, 405, 905, 1405]


def test_lateness_and_overruns_are_reported() -> None:
    rig = Rig(period_ns=MS)
    rig.bus.oversleep_ns = 100_000
    rig.run_until(300 * MS)
    rig.clock.advance_ns(7 * MS)
    rig.bus.oversleep_ns = 0
    rig.run_until(507 * MS)
    report = rig.health[1]
    # each wait came back 0.1 ms late; the sleep of 7 ms had begun 0.1 ms late too
    assert report.lateness_p50_s == pytest.approx(1e-4, rel=1e-9, abs=0)
    assert report.lateness_max_s == pytest.approx(6.1e-3, rel=1e-9, abs=0)
    assert report.overruns == rig.node.overruns == 6
    assert rig.bus.waits[-1] % MS == 0


def test_a_node_without_deadline_acts_on_messages_at_once() -> None:
    rig = Rig()
    for at_ms in (100, 101, 750):
        rig.bus.arrives(at_ms * MS, "haptic/state")
    rig.run_until(1000 * MS)
    assert [r.received_ns for r in rig.node.messages] == [100 * MS, 101 * MS, 750 * MS]
    assert rig.node.ticks == []
    # it waited no longer than to the next report
    assert max(b - a for a, b in zip([5 * MS, *rig.bus.waits], rig.bus.waits, strict=False)) <= HEALTH_PERIOD_NS


def test_time_that_passes_between_taking_and_acting_is_not_lost() -> None:
    """A process may be stopped anywhere: what it took before counts from when it goes on."""
    for stopped_ms, is_later in ((50, False), (51, True), (3000, True)):
        rig = Rig(period_ns=MS)
        rig.node.journalled = True
        rig.loop = NodeLoop(rig.node, rig.bus, GRANTED)
        rig.bus.arrives(5 * MS, "haptic/state")
        receive = rig.bus.receive

        def stopped(receive: Any = receive, rig: Rig = rig, stopped_ms: int = stopped_ms) -> list[Received]:
            taken = list(receive())
            rig.clock.advance_ns(stopped_ms * MS if taken else 0)
            return taken

        rig.bus.receive = stopped
        rig.loop.turn()
        (received,) = rig.node.messages
        assert (received.received_ns == rig.clock.now_ns()) is is_later
        assert (received.received_ns == 5 * MS) is not is_later


def test_a_message_that_moves_the_deadline_is_obeyed_in_the_same_turn() -> None:
    rig = Rig(period_ns=100 * MS)
    rig.bus.arrives(20 * MS, "haptic/state")

    def hurry(received: Received) -> None:
        rig.node.grid = PeriodicDeadline(received.received_ns - MS, MS)

    rig.node.on_message = hurry
    rig.loop.turn()
    rig.loop.turn()
    assert rig.node.ticks == [20 * MS]


class Ticking(Probe):
    """A node that carries ticks on."""

    journalled = True
    idle_after = "haptic/state"


def test_reports_go_out_in_idle_gaps_of_a_loop() -> None:
    rig = Rig()
    rig.node = Ticking(rig.node.context)
    rig.loop = NodeLoop(rig.node, rig.bus, GRANTED)
    for tick in range(6, 606):
        rig.bus.arrives(tick * MS, "haptic/state", src="haptic_node@master", seq=tick)
    sent_ns: list[tuple[str, int]] = []
    publish = rig.node.publish

    def noted(topic: str, **fields: Any) -> Message:
        sent_ns.append((topic, rig.clock.monotonic_ns()))
        return publish(topic, **fields)

    rig.node.publish = noted
    rig.run_until(605 * MS)
    # at the start nothing ticks yet; later each task has a gap of its own, from a quarter of a tick after it
    assert sent_ns == [
        ("node/health", 5 * MS),
        ("node/health", 506 * MS + 250_000),
        ("node/journal", 508 * MS + 250_000),
    ]


def test_a_report_waits_for_the_gap_that_the_node_names() -> None:
    rig = Rig()
    rig.node = Ticking(rig.node.context)
    rig.loop = NodeLoop(rig.node, rig.bus, GRANTED)
    for tick in range(6, 606):
        rig.bus.arrives(tick * MS, "haptic/state", src="haptic_node@master", seq=tick)
        rig.bus.arrives(tick * MS + 300_000, "teleop/backward", src="controller@slave", seq=tick)
    rig.run_until(605 * MS)
    # 0.3 ms, from the sample to the answer, each of which takes one
    assert rig.health[1].t_ns - 10**18 == 506 * MS + 300_000 // 4


def test_a_task_that_a_message_meets_makes_the_gap_shorter() -> None:
    """The message was there before the task was over, so the next one leaves it the time."""
    rig = Rig()
    rig.node = Ticking(rig.node.context)
    rig.loop = NodeLoop(rig.node, rig.bus, GRANTED)
    for tick in range(6, 306):
        rig.bus.arrives(tick * MS, "haptic/state", src="haptic_node@master", seq=tick)
    begun_ns: list[int] = []

    def task() -> None:
        begun_ns.append(rig.clock.monotonic_ns())
        rig.clock.advance_ns(900_000)

    rig.run_until(100 * MS)
    rig.node.defer(task)
    rig.run_until(101 * MS)
    rig.loop.turn()
    assert begun_ns == [100 * MS + 250_000]
    assert rig.loop._deferred._gap_ns == MS - 750_000 // 8


def test_a_batch_of_the_journal_begins_where_no_task_of_the_node_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig()
    rig.node = Ticking(rig.node.context)
    rig.loop = NodeLoop(rig.node, rig.bus, GRANTED)

    def defer(received: Received) -> None:
        if received.message.seq % 3 == 0:
            rig.node.defer(rig.node.carried_out.clear)
        rig.node.defer(rig.node.messages.clear, NEVER_NS)

    rig.node.on_message = defer
    waiting: list[int] = []
    begin = rig.loop._journal._begin

    def noted() -> None:
        waiting.append(any(task.is_turn for task in rig.loop._deferred._waiting))
        begin()

    rig.loop._journal._begin = noted
    for tick in range(6, 601):
        rig.bus.arrives(tick * MS, "haptic/state", src="haptic_node@master", seq=tick)
    rig.run_until(590 * MS)
    assert waiting == [False]
    # one that is full does not wait for a gap
    monkeypatch.setattr("telenano.runtime.loop.journal._BATCH", 20)
    journals = len(rig.bus.of(NodeJournal))
    rig.node.defer(rig.node.carried_out.clear)
    rig.loop.turn()
    assert waiting == [False, False]
    assert len(rig.bus.of(NodeJournal)) == journals + 1


def test_a_report_does_not_wait_for_ticks_that_come_no_more() -> None:
    rig = Rig()
    rig.node = Ticking(rig.node.context)
    rig.loop = NodeLoop(rig.node, rig.bus, GRANTED)
    for tick in range(6, 505):
        rig.bus.arrives(tick * MS, "haptic/state", src="haptic_node@master", seq=tick)
    rig.run_until(1100 * MS)
    assert [(h.t_ns - 10**18) / MS for h in rig.health][:3] == [5, 525, 1005]
    (journal,) = rig.bus.of(NodeJournal)
    assert journal.t_ns - 10**18 == 525 * MS


def test_stop_leaves_after_the_step_in_hand_and_makes_the_node_safe() -> None:
    rig = Rig(period_ns=MS)
    rig.node.on_message = lambda received: rig.node.context.request_stop()
    rig.bus.arrives(50 * MS + 1, "haptic/state")
    rig.loop.run()
    assert (rig.node.made_safe, rig.node.state, rig.node.context.stop_requested) == (1, "stopping", True)
    assert rig.node.ticks[-1] == 50 * MS
    assert rig.health[-1].state == "stopping"


def test_a_stop_before_the_first_turn_runs_nothing() -> None:
    rig = Rig(period_ns=MS)
    rig.node.context.request_stop()
    rig.loop.run()
    assert (rig.node.ticks, rig.node.made_safe, rig.node.state) == ([], 1, "stopping")


@pytest.mark.parametrize("where", ["deadline", "message", "bus"])
def test_a_failure_anywhere_leaves_the_node_safe_and_is_not_hidden(where: str) -> None:
    rig = Rig(period_ns=MS)
    rig.node.fails_at = 3 if where == "deadline" else None

    def fail(*_: object) -> Iterator[Received]:
        raise RuntimeError("driver gone")

    if where == "message":
        rig.node.on_message = fail
        rig.bus.arrives(7 * MS, "haptic/state")
    elif where == "bus":
        rig.bus.receive = fail
    with pytest.raises(RuntimeError, match="driver gone"):
        rig.loop.run()
    assert (rig.node.made_safe, rig.node.state) == (1, "stopping")
    assert rig.health[-1].state == "stopping"


def test_a_gap_is_reported_on_lossless_topics_alone() -> None:
    rig = Rig()
    rig.bus.arrives(10 * MS, "haptic/state", Arrival.AFTER_GAP)
    rig.bus.arrives(11 * MS, "session/event", Arrival.AFTER_GAP, seq=7, src="afm_node@slave")
    rig.bus.arrives(12 * MS, "session/event", Arrival.LATE)
    rig.run_until(20 * MS)
    assert len(rig.node.messages) == 3
    (event,) = rig.events
    assert (event.kind, event.level, event.id) == ("fault", "warning", "")
    assert event.text == "session/event: messages from afm_node@slave were lost before number 7"
    assert event.data == {"topic": "session/event", "source": "afm_node@slave", "seq": 7}


def test_refused_frames_are_in_the_report_and_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig()
    with caplog.at_level(logging.WARNING):
        rig.loop.turn()
        rig.bus.refused = {"malformed": 3}
        rig.run_until(1600 * MS)
        rig.bus.refused = {"malformed": 4}
        rig.run_until(2100 * MS)
    assert [h.rejected for h in rig.health][:2] == [{}, {"malformed": 3}]
    texts = [record.getMessage() for record in caplog.records]
    assert texts == ["refused: haptic/state: not msgpack"] * 2
    assert [record.facts["count"] for record in caplog.records] == [3, 1]


def test_what_happens_to_network_connections_is_an_event_and_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig(period_ns=MS)
    facts = {"peer": "afm_node@slave", "endpoint": "tcp://10.0.0.2:5712", "connection": "down"}
    rig.loop.turn()
    with caplog.at_level(logging.INFO):
        rig.bus.notices = [
            ConnectionEvent("warning", "the connection is lost", facts),
            ConnectionEvent("info", "it is back", {}),
        ]
        rig.loop.turn()
    assert [(e.kind, e.level, e.text, e.data, e.id) for e in rig.events] == [
        ("network", "warning", "the connection is lost", facts, ""),
        ("network", "info", "it is back", {}, ""),
    ]
    assert [(r.levelname, r.getMessage(), r.facts) for r in caplog.records] == [
        ("WARNING", "the connection is lost", {"kind": "network", **facts}),
        ("INFO", "it is back", {"kind": "network"}),
    ]


def test_connections_are_looked_after_in_every_turn_and_in_any_case_with_every_report() -> None:
    rig = Rig(period_ns=MS)
    rig.run_until(1100 * MS)
    assert rig.bus.attended.count(True) == len(rig.health) == 3
    assert rig.bus.attended.count(False) == len(rig.bus.waits)


def test_the_last_message_counts_all_that_were_sent() -> None:
    rig = Rig(period_ns=MS)
    rig.run_until(700 * MS)
    rig.node.context.request_stop()
    rig.loop.run()
    before, last = rig.bus.sent[-2:]
    assert isinstance(before, NodeHealth) and before.state == "stopping"
    # the bus of this bench counts everything as haptic/state; the last message counts itself
    counts = {("haptic/state", "n@s"): len(rig.bus.sent) - 1, ("session/event", "n@s"): 1}
    assert read_end(fields_of(last)) == counts


def test_connection_events_at_the_very_end_are_published_too() -> None:
    rig = Rig(period_ns=MS)
    rig.node.context.request_stop()
    rig.bus.notices = [ConnectionEvent("info", "it is back", {})]
    rig.loop.run()
    assert [e.text for e in rig.events if e.kind == "network"] == ["it is back"]


def test_a_command_reaches_the_node_and_its_handler() -> None:
    rig = Rig()
    rig.bus.arrives(10 * MS, "session/control", id="x1", command="set", target="controller", parameters={"gain": 2.0})
    rig.run_until(20 * MS)
    assert len(rig.node.messages) == 1
    assert [(e.id, e.kind, e.text) for e in rig.events] == [("x1", "ack", "gain is 2.0")]


# --- commands ---


def test_whatever_a_person_can_get_wrong_is_a_refusal() -> None:
    rig = Rig()
    rig.command(command="estop")
    assert [(e.kind, e.text) for e in rig.events] == [("refused", "controller.gain: is missing")]


def test_a_refusal_longer_than_an_event_holds_is_cut_short() -> None:
    rig = Rig()
    rig.command(target="controller", **{"x" * 10_000: 1.0})
    (event,) = rig.events
    assert event.kind == "refused"
    assert len(event.text) == MAX_TEXT


def test_an_event_can_name_a_file_that_is_not_unicode() -> None:
    rig = Rig()
    rig.node.event("fault", "error", "cannot read /tmp/\udcff")
    assert rig.events[0].text == "cannot read /tmp/?"


@given(st.text(max_size=64), st.text(max_size=30))
def test_no_command_can_stop_a_node(target: str, key: str) -> None:
    rig = Rig()
    rig.command(target=target, **{key: 1.0})
    rig.command(target="controller", identifier="b", **{key: 1.0})
    assert rig.events[-1].id == "b"


@pytest.mark.parametrize("stopped_s", [0.9, 4.0])
def test_a_node_that_was_stopped_does_not_obey_what_waited_for_it(stopped_s: float) -> None:
    rig = Rig(period_ns=MS)
    rig.run_until(100 * MS)
    # the clock of the sender is ahead by as much as the command is old
    fields = {"command": "set", "target": "controller", "parameters": {"gain": 2.0}}
    t_ns = rig.clock.now_ns() + round(stopped_s * 1e9)
    rig.bus.arrives(100 * MS, "session/control", id="waited", t_ns=t_ns, **fields)
    rig.clock.advance_ns(round(stopped_s * 1e9))
    rig.loop.turn()
    assert rig.node.carried_out == (["waited"] if stopped_s < 1.0 else [])
    assert [e.kind for e in rig.events] == (["ack"] if stopped_s < 1.0 else ["refused"])
    # a second later it trusts the clocks of others again
    rig.run_until(rig.clock.monotonic_ns() + 1001 * MS)
    rig.bus.arrives(rig.clock.monotonic_ns() + MS, "session/control", id="later", **fields)
    rig.run_until(rig.clock.monotonic_ns() + 2 * MS)
    assert rig.node.carried_out[-1] == "later"


# --- signals and memory ---


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_the_loop_and_ends_its_wait(number: signal.Signals) -> None:
    stops: list[int] = []
    descriptor = install_stop_signals(lambda: stops.append(1))
    try:
        assert select.select([descriptor], (), (), 0)[0] == []
        signal.raise_signal(number)
        assert stops == [1]
        assert select.select([descriptor], (), (), 5.0)[0] == [descriptor]
    finally:
        os.close(descriptor)


def test_resident_memory_is_measured() -> None:
    before = resident_bytes()
    ballast = b"x" * 80_000_000
    assert resident_bytes() - before > 70_000_000
    assert len(ballast) == 80_000_000


def test_an_event_is_written_to_the_log(caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig()
    with caplog.at_level(logging.INFO):
        rig.node.event("mode", "warning", "holding", gap_m=1e-9)
    (record,) = caplog.records
    assert (record.levelname, record.getMessage(), record.facts) == (
        "WARNING",
        "holding",
        {"kind": "mode", "gap_m": 1e-9},
    )
    assert json.dumps(record.facts)


class Journalled(Probe):
    """A probe whose inputs are journalled; it reads its clock at every turn, while time passes."""

    journalled = True

    def __init__(self, context: NodeContext, period_ns: int = 0) -> None:
        super().__init__(context, period_ns)
        self.read: list[tuple[int, int]] = []

    def on_message(self, received: Received) -> None:
        self._read()

    def on_deadline(self, now_ns: int) -> None:
        super().on_deadline(now_ns)
        self._read()

    def on_control(self, control: SessionControl) -> str:
        self._read()
        return super().on_control(control)

    def make_safe(self) -> None:
        self._read()

    def _read(self) -> None:
        self.context.bus.clock.advance_ns(20_000)  # type: ignore[attr-defined]
        self.read.append((self.clock.monotonic_ns(), self.clock.now_ns()))


def journalled_rig(period_ns: int = 0) -> Rig:
    rig = Rig()
    rig.node = Journalled(rig.node.context, period_ns)
    rig.loop = NodeLoop(rig.node, rig.bus, GRANTED)
    return rig


def turns_of(journal: Any) -> list[tuple[int, ...]]:
    arrays = (journal.kind, journal.time_ns, journal.input, journal.number)
    return list(zip(*(found.to_numpy().tolist() for found in arrays), strict=True))


def test_a_turn_has_one_time_that_the_journal_has_too() -> None:
    rig = journalled_rig(period_ns=100 * MS)
    epoch = 10**18
    rig.bus.arrives(30 * MS, "haptic/state", src="haptic_node@master", seq=4)
    rig.bus.coming[0] = (30 * MS, rig.bus.coming[0][1]._replace(received_ns=30 * MS + epoch))
    rig.run_until(500 * MS)
    node = rig.node
    assert isinstance(node, Journalled)
    ticks = [tick * 100 * MS + 5 * MS for tick in range(1, 6)]
    assert [monotonic for monotonic, _ in node.read] == [30 * MS, *ticks]
    assert all(now - monotonic == epoch for monotonic, now in node.read)
    (journal,) = rig.bus.of(NodeJournal)
    assert journal.first_turn == 0
    assert journal.epoch_offset_ns == epoch
    assert [(found.topic, found.src) for found in journal.inputs] == [("haptic/state", "haptic_node@master")]
    assert turns_of(journal) == [(1, 30 * MS + epoch, 0, 4), *((0, tick + epoch, -1, -1) for tick in ticks)]
    # what a turn publishes goes out before the journal of it
    assert rig.bus.sent[-1] is journal


def test_a_late_deadline_has_the_time_after_the_wait() -> None:
    rig = journalled_rig(period_ns=100 * MS)
    rig.bus.oversleep_ns = 3 * MS
    rig.run_until(520 * MS)
    (journal,) = rig.bus.of(NodeJournal)
    assert {turn[1] - 10**18 - 8 * MS for turn in turns_of(journal)} <= {tick * 100 * MS for tick in range(1, 6)}


def test_the_journal_records_which_command_was_carried_out() -> None:
    rig = journalled_rig()
    for at_ms, name in ((10, "one"), (20, "one"), (30, "two")):
        target = "*" if name == "one" else "afm_node"
        fields = {"id": name, "command": "set", "target": target, "parameters": {"gain": 1}, "t_ns": at_ms * MS}
        rig.bus.arrives(at_ms * MS, "session/control", seq=at_ms, **fields)
    rig.run_until(510 * MS)
    (journal,) = rig.bus.of(NodeJournal)
    assert [(kind, number) for kind, _, _, number in turns_of(journal)] == [(2, 10), (1, 20), (1, 30)]


def test_the_journal_numbers_its_turns_and_the_outputs_so_far() -> None:
    rig = journalled_rig(period_ns=MS)
    rig.run_until(1600 * MS)
    journals = rig.bus.of(NodeJournal)
    assert len(journals) == 3
    assert [found.first_turn for found in journals[1:]] == [
        sum(len(turns_of(found)) for found in journals[:count]) for count in (1, 2)
    ]
    # those of turns: what the first journal came in is none of them
    assert journals[1].outputs == {"haptic/state": rig.bus.sent.index(journals[0])}


def test_a_flood_makes_a_batch_before_the_half_second(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal, "_BATCH", 100)
    rig = journalled_rig()
    rig.loop.turn()
    for seq in range(150):
        rig.bus.arrives(6 * MS + seq * 100, "haptic/state", seq=seq)
    rig.run_until(400 * MS)
    (flood, *_) = rig.bus.of(NodeJournal)
    assert len(turns_of(flood)) >= 100
    assert flood.t_ns - 10**18 < 10 * MS


def test_the_health_of_others_is_no_turn_and_an_idle_node_writes_nothing() -> None:
    rig = journalled_rig()
    rig.bus.arrives(10 * MS, "node/health")
    rig.run_until(1100 * MS)
    assert rig.bus.of(NodeJournal) == []


def test_the_health_of_others_is_a_turn_of_who_acts_on_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Journalled, "acts_on_health", True)
    rig = journalled_rig()
    rig.bus.arrives(10 * MS, "node/health", src="afm_node@slave", seq=3)
    rig.run_until(510 * MS)
    (found,) = rig.bus.of(NodeJournal)
    assert [(kind, number) for kind, _, _, number in turns_of(found)] == [(1, 3)]


def test_the_journal_counts_what_goes_past_the_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Journalled, "further_outputs", lambda node: {"delay_node@slave": len(node.read)})
    rig = journalled_rig(period_ns=100 * MS)
    rig.run_until(1100 * MS)
    assert [found.outputs["delay_node@slave"] for found in rig.bus.of(NodeJournal)] == [0, 5]


def test_the_rest_of_the_journal_is_sent_at_the_end_and_making_safe_is_no_turn() -> None:
    rig = journalled_rig(period_ns=10 * MS)
    rig.run_until(40 * MS)
    rig.node.context.request_stop()
    rig.loop.run()
    node = rig.node
    assert isinstance(node, Journalled)
    assert node.clock is rig.clock
    assert node.read[-1][0] == rig.clock.monotonic_ns()
    (journal,) = rig.bus.of(NodeJournal)
    assert len(turns_of(journal)) == len(node.read) - 1


def test_a_node_without_a_journal_reads_the_clock_itself() -> None:
    rig = Rig(period_ns=MS)
    rig.run_until(600 * MS)
    assert rig.node.clock is rig.clock
    assert rig.bus.of(NodeJournal) == []

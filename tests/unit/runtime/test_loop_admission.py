"""The loop asks its node what may be acted on, does deferred work, and counts what was refused."""

import logging
from typing import Any

import pytest
from test_runtime_node import MS, FakeBus, Rig

from services.afm_node.node import AfmNode
from telenano.afm.sim import simulated_afm
from telenano.runtime.loop.commands import STALL_NS
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import NodeContext
from telenano.runtime.loop.node_loop import STARTING_PERIOD_NS, NodeLoop
from telenano.runtime.loop.realtime import RealtimeStatus
from telenano.sections.afm_section import AfmConfig
from telenano.testing import VirtualClock
from telenano.timing.clock import NEVER_NS
from telenano.wire.messages import SUPERSEDED, SessionControl, SessionEvent
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival

PLAIN = RealtimeStatus(fifo=False, memory_locked=False)


def test_what_a_node_does_not_admit_reaches_neither_its_state_nor_its_commands() -> None:
    rig = Rig()
    rig.node.admits = lambda received: received.message.src != "controller@slave"
    for src in ("haptic_node@master", "controller@slave"):
        rig.bus.arrives(5 * MS, "haptic/state", src=src)
    rig.loop.turn()
    assert [received.message.src for received in rig.node.messages] == ["haptic_node@master"]
    rig.node.admits = lambda received: not isinstance(received.message, SessionControl)
    rig.command(gain=2.0)
    assert rig.node.carried_out == []
    assert rig.events == []
    # a gap is reported whether or not the message behind it may be acted on
    rig.bus.arrives(6 * MS, "session/control", Arrival.AFTER_GAP)
    rig.run_until(7 * MS)
    assert ["were lost before number" in event.text for event in rig.events] == [True]


def test_what_is_not_admitted_is_not_in_the_journal_either() -> None:
    rig = Rig()
    rig.node.journalled = True
    rig.loop = NodeLoop(rig.node, rig.bus, PLAIN)
    recorded: list[Received] = []
    rig.loop._journal.record_message = lambda received, executed: recorded.append(received)
    rig.node.admits = lambda received: received.message.src == "haptic_node@master"
    for src in ("controller@slave", "haptic_node@master"):
        rig.bus.arrives(5 * MS, "haptic/state", src=src)
    rig.loop.turn()
    assert [received.message.src for received in recorded] == ["haptic_node@master"]


class Device:
    """The instrument in its loop, on a bus in virtual time."""

    def __init__(self, **section: Any) -> None:
        self.clock = VirtualClock(start_ns=10**9, epoch_offset_ns=10**18)
        self.bus = FakeBus(self.clock)
        config = AfmConfig(**section)
        context = NodeContext("afm_node@slave", self.clock, self.bus, StructuredLog("afm_node@slave"))
        self.node = AfmNode(context, config, simulated_afm(config.to_params()))
        self.loop = NodeLoop(self.node, self.bus, PLAIN)
        self._seq = 0

    def arrives(self, topic: str, **fields: Any) -> None:
        """Let a message arrive, sent now, and take a turn."""
        now_ns = self.clock.monotonic_ns()
        fields = {"seq": self._seq, "t_ns": self.clock.now_ns(), **fields}
        self._seq += 1
        self.bus.arrives(now_ns, topic, **fields)
        at, received = self.bus.coming.pop()
        self.bus.coming.append((at, received._replace(received_ns=self.clock.now_ns())))
        self.loop.turn()

    def command(self, base_m: float) -> None:
        self.clock.advance_ns(MS)
        position = (0.0, 0.0, -base_m)
        self.arrives(
            "afm/command", src="controller@slave", base_position_m=position, mode="position",
            hand_t_ns=self.clock.now_ns(), hand_armed=True,
        )  # fmt: skip

    def control(self, command: str) -> None:
        word = {"place": "hand"} if command == "arm" else {}
        fields = {"id": command, "command": command, "target": "afm_node", "parameters": word}
        self.arrives("session/control", src="launcher@master", **fields)

    @property
    def events(self) -> list[SessionEvent]:
        return self.bus.of(SessionEvent)


@pytest.mark.parametrize("allow_replay", [False, True])
def test_the_instrument_in_its_loop_does_not_obey_a_recording_unless_that_is_allowed(allow_replay: bool) -> None:
    device = Device(allow_replay=allow_replay)
    for _ in range(3):
        device.command(-50e-9)
    device.control("arm")
    assert device.node.state == "running"
    for _ in range(5):
        device.command(-90e-9)
    before_m = device.node._memory.guard.base_m
    device.arrives("node/health", src="controller@slave", replay=True)
    for _ in range(20):
        device.command(-50e-9)
    moved_m = device.node._memory.guard.base_m - before_m
    assert (moved_m > 30e-9) is allow_replay
    texts = [event.text for event in device.events if "come from a recording" in event.text]
    assert len(texts) == int(not allow_replay)
    # an emergency stop is obeyed whoever sends it
    device.arrives("node/health", src="launcher@master", replay=True)
    device.control("estop")
    assert device.node.state == "safe"


def test_a_deferred_task_of_a_node_without_a_deadline_is_run_when_it_is_due() -> None:
    rig = Rig()
    done: list[int] = []
    rig.run_until(10 * MS)
    assert rig.node.deadline_ns() == NEVER_NS
    deferred, now_ns = rig.node.context.deferred, rig.clock.monotonic_ns()
    deferred.note_event(now_ns, now_ns, is_last=True)
    rig.node.defer(lambda: done.append(rig.clock.monotonic_ns()))
    rig.run_until(now_ns + 30 * MS)
    # no gap is known, so it waits for the 20 ms that any task waits at most, and for no report of the loop
    assert done == [now_ns + 20 * MS]
    assert deferred.due_ns == NEVER_NS


def test_a_deferred_task_of_a_node_with_a_deadline_does_not_wait_for_it() -> None:
    rig = Rig(period_ns=500 * MS)
    done: list[int] = []
    # the first report
    rig.loop.turn()
    now_ns = rig.clock.monotonic_ns()
    rig.node.defer(lambda: done.append(rig.clock.monotonic_ns()))
    rig.loop.turn()
    assert (done, rig.node.ticks) == ([now_ns], [])


def test_messages_that_a_newer_one_replaced_are_no_refusal_to_be_logged(caplog: pytest.LogCaptureFixture) -> None:
    rig = Rig()
    caplog.set_level(logging.WARNING)
    rig.bus.refused = {SUPERSEDED: 400}
    rig.run_until(1100 * MS)
    assert [record for record in caplog.records if "refused" in record.getMessage()] == []
    # they are in the account of health all the same
    assert rig.health[-1].rejected == {SUPERSEDED: 400}
    rig.bus.refused = {SUPERSEDED: 900, "malformed": 2}
    rig.run_until(2100 * MS)
    logged = [record for record in caplog.records if "refused" in record.getMessage()]
    assert len(logged) == 1
    rig.bus.refused = {SUPERSEDED: 5000, "malformed": 2}
    rig.run_until(3100 * MS)
    assert len([record for record in caplog.records if "refused" in record.getMessage()]) == 1


def test_a_step_before_the_first_report_is_in_its_rate() -> None:
    rig = Rig()

    def step(received: Received) -> None:
        rig.node.steps += 1
        rig.clock.advance_ns(MS)

    rig.node.on_message = step
    rig.bus.arrives(5 * MS, "haptic/state")
    rig.loop.turn()
    assert [report.rate_hz for report in rig.health] == [pytest.approx(1000.0, rel=1e-9, abs=0.0)]


def test_a_node_was_held_up_when_it_did_nothing_for_longer_than_a_command_is_valid() -> None:
    rig = Rig()
    rig.loop.turn()
    noted: list[int] = []
    rig.loop._commands.note_stall = lambda now_ns, duration_ns: noted.append(duration_ns)
    for pause_ns in (STALL_NS, STALL_NS + 1):
        rig.clock.advance_ns(pause_ns)
        rig.bus.wait = lambda deadline_ns: None
        rig.loop.turn()
    assert noted == [STALL_NS + 1]


def test_a_node_that_starts_reports_ten_times_a_second() -> None:
    rig = Rig(period_ns=MS)
    rig.loop = NodeLoop(rig.node, rig.bus, PLAIN, starting_period_ns=STARTING_PERIOD_NS)
    rig.run_until(1004 * MS)
    assert len(rig.health) == 10

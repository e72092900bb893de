"""When the loop looks for a stop that was kept, what a stop of its own and a failure say, and when a report is due."""

from functools import partial
from pathlib import Path

import msgspec
import pytest
from test_runtime_node import GRANTED, MS, Rig, Ticking, journalled_rig, turns_of

from telenano.runtime.bus.places import Places
from telenano.runtime.loop.commands import stop_of
from telenano.runtime.loop.journal import DEFERRED
from telenano.runtime.loop.kept_stop import keep
from telenano.runtime.loop.node_loop import NodeLoop
from telenano.wire import encode
from telenano.wire.errors import EndpointError
from telenano.wire.journal_messages import NodeJournal
from telenano.wire.messages import SessionControl

NODE = "controller@master"
# one that stood still for longer has missed its deadline
STOOD_STILL_NS = 51 * MS


class Stoppable:
    """A node with a place in which a stop is kept for it, and what it executed."""

    def __init__(self, folder: Path) -> None:
        self.rig = Rig(period_ns=MS)
        self.path = self.rig.node.context.kept_stop = folder / "x.kept"
        self.executed: list[str] = []
        self.rig.node.on_control = self.execute
        self.rig.loop = NodeLoop(self.rig.node, self.rig.bus, GRANTED)

    def execute(self, control: SessionControl) -> str:
        self.executed.append(control.command)
        return "done"

    def keep(self) -> None:
        assert keep(self.path, encode(stop_of(NODE, self.rig.clock.now_ns()))) == ""


def test_a_stop_that_was_kept_is_obeyed_before_what_waits_when_the_node_starts(tmp_path: Path) -> None:
    node = Stoppable(tmp_path)
    node.keep()
    node.rig.command(gain=1.0)
    assert node.executed == ["estop", "set"]


def test_a_stop_that_was_kept_is_obeyed_before_what_waited_while_the_node_stood_still(tmp_path: Path) -> None:
    node = Stoppable(tmp_path)
    node.rig.run_until(100 * MS)
    node.keep()
    # a loop that goes on looks with its next report, and not in each turn
    node.rig.command(gain=1.0)
    assert node.executed == ["set"]
    node.rig.clock.advance_ns(STOOD_STILL_NS)
    node.rig.command(gain=2.0, identifier="waited")
    assert node.executed == ["set", "estop", "set"]


def test_a_node_that_runs_looks_twice_a_second_for_a_stop_that_was_kept(tmp_path: Path) -> None:
    node = Stoppable(tmp_path)
    kept, looked_ns = node.rig.loop._commands.latch.kept, list[int]()

    def looked() -> bytes | None:
        looked_ns.append(node.rig.clock.monotonic_ns())
        return kept()

    node.rig.loop._commands.latch.kept = looked
    node.rig.run_until(2100 * MS)
    # before the first turn acts, and in the turn behind each report
    assert [time_ns // MS for time_ns in looked_ns] == [5, 6, 506, 1006, 1506, 2006]
    node.keep()
    node.rig.run_until(2600 * MS)
    assert node.executed == ["estop"]


def test_a_stop_by_a_signal_is_obeyed_in_the_next_turn_before_what_waits(tmp_path: Path) -> None:
    node = Stoppable(tmp_path)
    node.rig.run_until(100 * MS)
    node.rig.loop.note_stop_signal()
    node.rig.command(gain=1.0, program="curve")
    # It is the newest stop for what comes later, and is kept as any other.
    assert node.executed == ["estop"]
    assert node.path.exists()
    assert [event.kind for event in node.rig.events if event.id == "a"] == ["refused"]
    node.rig.run_until(1200 * MS)
    assert node.executed == ["estop"], "it is obeyed once"
    node.rig.loop.note_stop_signal()
    node.rig.run_until(1300 * MS)
    assert node.executed == ["estop", "estop"]


class Removed:
    """A place of a process that others remove, and that may not be had again."""

    def __init__(self) -> None:
        self.is_lost = self.is_taken = False

    def lost(self) -> str:
        return "/run/x" if self.is_lost else ""

    def make_again(self) -> None:
        if self.is_taken:
            raise EndpointError("another rig has it")
        self.is_lost = False


@pytest.mark.parametrize("key", [NODE, "afm_node@slave"])
def test_a_device_whose_place_is_gone_for_good_stops_by_itself_and_begins_nothing(tmp_path: Path, key: str) -> None:
    node, place = Stoppable(tmp_path), Removed()
    context = node.rig.node.context
    context.key, context.places = key, Places()
    context.places.add(place)
    node.rig.loop = NodeLoop(node.rig.node, node.rig.bus, GRANTED)

    def told(state: str) -> list[str]:
        return [event.text for event in node.rig.events if event.data.get("state") == state]

    def moves(identifier: str) -> str:
        node.rig.command(gain=1.0, program="curve", identifier=identifier, target=key)
        return next(event.text for event in node.rig.events[::-1] if event.id == identifier)

    node.rig.run_until(1100 * MS)
    place.is_lost = True
    node.rig.run_until(1700 * MS)
    # Half a second later it is there again, and nothing else has happened.
    assert (len(told("made_again")), told("lost"), node.executed) == (1, [], [])
    place.is_lost = place.is_taken = True
    node.rig.run_until(2300 * MS)
    assert (len(told("lost")), node.executed) == (1, [])
    assert "an emergency stop might not reach this node: another rig has it" in moves("b")
    node.rig.run_until(2900 * MS)
    stops = ["estop"] if key == "afm_node@slave" else []
    assert node.executed == stops
    node.rig.run_until(5000 * MS)
    assert (len(told("lost")), node.executed) == (1, stops)
    place.is_taken = False
    node.rig.run_until(5600 * MS)
    assert len(told("made_again")) == 2
    answer = moves("c")
    assert "might not reach" not in answer
    assert ("does not refer to the newest emergency stop" in answer) == bool(stops)


def test_only_a_device_that_stopped_itself_asks_for_a_new_wish_to_move() -> None:
    rig = Rig(period_ns=MS)
    rig.run_until(10 * MS)
    rig.command(gain=1.0, program="curve")
    rig.node.own_stops += 1
    rig.run_until(rig.clock.monotonic_ns() + 2 * MS)
    rig.command(gain=1.0, program="curve", identifier="b")
    assert [(event.id, event.kind) for event in rig.events] == [("a", "ack"), ("b", "refused")]
    assert "does not refer to the newest emergency stop" in rig.events[-1].text


def test_a_failure_is_an_event_that_names_it() -> None:
    rig = Rig(period_ns=MS)
    rig.node.fails_at = 3
    with pytest.raises(RuntimeError):
        rig.loop.run()
    (fault,) = [event for event in rig.events if event.kind == "fault"]
    assert (fault.level, fault.text) == ("error", "this node failed: RuntimeError: driver gone")


def test_whoever_drives_a_loop_learns_when_a_report_or_a_piece_of_one_is_due() -> None:
    rig = Rig()
    rig.node = Ticking(rig.node.context)
    rig.loop = NodeLoop(rig.node, rig.bus, GRANTED)
    for tick in range(6, 520):
        rig.bus.arrives(tick * MS, "haptic/state", src="haptic_node@master", seq=tick)
    rig.run_until(504 * MS)
    assert rig.loop.health_due_ns == 505 * MS
    # its tasks wait for an idle gap
    rig.run_until(505 * MS)
    assert rig.loop.health_due_ns == 505 * MS + 250_000
    rig.run_until(519 * MS)
    assert rig.loop.health_due_ns == 1005 * MS


def test_a_kept_file_that_is_no_stop_stops_the_node_all_the_same(tmp_path: Path) -> None:
    node = Stoppable(tmp_path)
    start = msgspec.structs.replace(stop_of(NODE, node.rig.clock.now_ns()), command="start")
    assert keep(node.path, encode(start)) == ""
    node.rig.loop.turn()
    assert node.executed == ["estop"]


def test_a_stop_of_its_own_is_noted_once() -> None:
    rig, noted = Rig(period_ns=MS), list[int]()
    rig.loop._commands.note_own_stop = noted.append
    rig.run_until(10 * MS)
    rig.node.own_stops += 1
    rig.run_until(20 * MS)
    assert len(noted) == 1


def test_a_report_states_the_share_of_a_processor_since_the_last_one(monkeypatch: pytest.MonkeyPatch) -> None:
    begun_s = 7.0
    # The clock of processor time may step back, and no share is negative.
    used_s = iter((begun_s, begun_s + 0.1, begun_s + 0.25, begun_s + 0.2))
    monkeypatch.setattr("telenano.runtime.loop.machine.time.process_time", lambda: next(used_s))
    rig = Rig(period_ns=MS)
    rig.run_until(1010 * MS)
    assert [report.cpu_percent for report in rig.health[1:]] == pytest.approx([30.0, 0.0])


def test_a_report_counts_what_was_too_old_to_act_on() -> None:
    rig = Rig(period_ns=MS)
    rig.node.stale = 3
    rig.run_until(510 * MS)
    assert rig.health[-1].rejected == {"stale": 3}


@pytest.mark.parametrize("is_full", [False, True], ids=["in a gap", "before a full batch ends"])
def test_a_task_that_the_outputs_depend_on_is_a_turn_of_the_journal(is_full: bool) -> None:
    rig, ran = journalled_rig(), list[str]()
    kinds: list[int] = []
    rig.loop._journal.record_turn = kinds.append
    rig.node.defer(lambda: ran.append("task"))
    if is_full:
        rig.loop._end_batch()
    else:
        rig.loop._run_deferred()
    assert (ran, kinds) == (["task"], [DEFERRED])


def test_a_batch_of_the_journal_does_not_end_while_a_task_waits_although_all_are_overdue() -> None:
    rig, ran = journalled_rig(), list[str]()
    # nothing has happened for a while, so that all of them are due at once
    rig.loop._deferred.add(rig.loop._complete_batch)
    for name in ("forward", "backward"):
        rig.node.defer(partial(ran.append, name))
    rig.loop._run_deferred()
    assert ran == ["forward", "backward"]
    (batch,) = rig.bus.of(NodeJournal)
    assert [kind for kind, *_ in turns_of(batch)] == [DEFERRED, DEFERRED]


def test_a_message_of_the_journal_that_leaves_some_is_followed_by_the_next() -> None:
    rig, left = journalled_rig(), [True, True, False]
    rig.loop._journal.publish = lambda: left.pop(0)
    rig.loop._publish_journal()
    rig.loop._run_deferred()
    assert left == []

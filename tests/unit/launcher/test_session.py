from io import StringIO
from typing import Any

import msgspec
import pytest
from launcher_bench import NODES, SECOND_NS, TICK_NS, Rig, health, row
from rich.console import Console

from telenano.cli.live_view import nodes_table, rig_picture
from telenano.launcher.readiness import READY_DEADLINE_S, oldest_input_s, silent_inputs, unmet
from telenano.launcher.rig_node import _Ending
from telenano.runtime.bus.places import Places
from telenano.wire.errors import EndpointError
from telenano.wire.messages import NodeHealth, SessionEvent
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival


def test_a_whole_session() -> None:
    rig = Rig(duration_s=2.0)
    assert rig.children.started == NODES
    rig.tick(5)
    assert rig.session.phase == "starting"
    assert rig.bus.controls() == []
    rig.all_ready()
    # each command follows the answer to the one before it, and not the next tick
    rig.tick(3)
    assert rig.session.phase == "running"
    assert [(c.command, c.target) for c in rig.bus.controls()] == [
        ("arm", "haptic_node"),
        ("arm", "afm_node"),
        ("start", "*"),
    ]
    rig.tick(39)
    assert rig.session.phase == "running"
    rig.tick(2)
    assert rig.finished
    assert rig.bus.controls()[-1].command == "stop"
    assert rig.session.failure == ""
    assert rig.session.ran
    rig.session.make_safe()
    assert rig.children.stopped == 1


@pytest.mark.parametrize("before", [True, False])
def test_the_hand_is_started_when_the_tip_is_placed_however_long_that_takes(before: bool) -> None:
    rig = Rig(duration_s=2.0)
    rig.places = False
    rig.all_ready()
    # the instrument may say how long its way takes before it answers, or after that
    says = ("afm_node@slave", "mode", "its base goes from -100 nm to 0 nm")
    rig.tick(1 if before else 2)
    rig.receive_event(*says, mode="follow", placing_s=6.7)
    # at 15 nm/s it takes 6.7 s, and the limit is twice that and five seconds
    rig.tick_alive(6 * SECOND_NS // TICK_NS)
    assert rig.session.phase == "arming"
    assert rig.session.elapsed_s == 0.0
    assert "placing the tip" in rig.session.status_line()
    assert not any(control.command == "start" for control in rig.bus.controls())
    rig.receive_event("afm_node@slave", "mode", "the tip is placed: its base is at 0 nm", mode="follow", placed=True)
    rig.tick()
    assert [control.command for control in rig.bus.controls()][-1] == "start"
    assert rig.session.phase == "running"


@pytest.mark.parametrize(
    ("said", "limit_s", "why"),
    [
        ({"text": "its base goes from -100 nm to 0 nm", "mode": "follow", "placing_s": 2.0}, 9.0, "its base goes from"),
        ({"text": "the AFM is in mode retracting: force_limit", "mode": "retracting"}, 0.2, "force_limit"),
        (None, 5.0, "reason"),
    ],
    ids=["a base that does not come", "a guard that acts", "a tip that waits for the hand"],
)
def test_a_tip_that_is_not_placed_ends_the_rig_with_its_newest_word(said: Any, limit_s: float, why: str) -> None:
    rig = Rig(duration_s=2.0)
    rig.places = False
    rig.all_ready()
    rig.tick(2)
    if said is not None:
        rig.receive_event("afm_node@slave", "mode", **said)
    ticks = 0
    while not rig.finished:
        rig.tick_alive()
        ticks += 1
    assert ticks * TICK_NS * 1e-9 == pytest.approx(limit_s, abs=0.3)
    assert rig.session.failure.startswith("afm_node@slave was not placed within ")
    assert why in rig.session.failure
    assert not any(control.command == "start" for control in rig.bus.controls())


@pytest.mark.parametrize("answers", [True, False])
def test_a_stand_in_for_the_hand_is_sent_what_the_hand_would_be_sent(answers: bool) -> None:
    others = [node for node in NODES if node != "haptic_node@master"]
    rig = Rig(duration_s=2.0, own=others)
    if answers:
        rig.rig_nodes.append("haptic_node@master")
    rig.receive_health(*others)
    rig.tick(40)
    assert rig.session.phase == "running"
    sent = list(dict.fromkeys((control.command, control.target) for control in rig.bus.controls()))
    assert sent == [("arm", "haptic_node"), ("arm", "afm_node"), ("start", "*")]


def test_a_silent_node_is_asked_again_with_the_same_id_and_then_named() -> None:
    rig = Rig()
    rig.silent = {"haptic_node@master"}
    rig.all_ready()
    rig.tick(150)
    assert rig.finished
    assert rig.session.failure == "haptic_node@master did not answer arm in time"
    to_haptic = [control.id for control in rig.bus.controls() if control.target == "haptic_node"]
    assert len(to_haptic) == 25
    assert len(set(to_haptic)) == 1
    assert not any(control.command == "start" for control in rig.bus.controls())


def test_a_refusal_ends_the_rig_with_its_reason() -> None:
    rig = Rig()
    rig.refusing = {"afm_node@slave"}
    rig.all_ready()
    rig.tick(90)
    assert not rig.finished
    rig.tick(30)
    assert rig.finished
    assert rig.session.failure == "afm_node@slave refused arm: reason"


@pytest.mark.parametrize("device", ["afm_node@slave", "haptic_node@master"])
def test_an_emergency_stop_ends_the_start_of_a_session_at_once(device: str) -> None:
    rig = Rig()
    rig.refusing = {"afm_node@slave"}
    rig.all_ready()
    rig.tick(20)
    rig.receive_event(device, "ack", "emergency stop latched", answer_to="x", command="estop")
    asked = len(rig.bus.controls())
    rig.refusing = set()
    rig.tick(2)
    assert rig.finished
    assert rig.session.failure == f"{device} was stopped by an emergency stop"
    assert len(rig.bus.controls()) == asked


def test_an_emergency_stop_in_a_running_session_does_not_end_it() -> None:
    rig = Rig()
    rig.all_ready()
    rig.tick(4)
    rig.receive_event("afm_node@slave", "ack", "emergency stop latched", answer_to="x", command="estop")
    rig.tick(2)
    assert (rig.session.phase, rig.session.failure) == ("running", "")


def test_a_stop_between_the_start_of_the_rig_and_its_arming_ends_the_session() -> None:
    rig = Rig()
    rig.silent = {"afm_node@slave"}
    rig.tick(20)
    rig.all_ready()
    rig.tick(1)
    asked = rig.bus.controls()[-1].id
    facts = {"command": "arm", "latch": "5d0c-1", "latched": True, "estop_age_s": 0.5}
    rig.receive_event("afm_node@slave", "refused", answer_to=asked, **facts)
    rig.tick(2)
    assert rig.finished
    assert rig.session.failure.startswith("arm is void: an emergency stop came to afm_node@slave after it")


@pytest.mark.parametrize("wait_s", [None, 20.0])
def test_a_device_that_is_in_emergency_stop_from_before_is_waited_for(wait_s: float | None) -> None:
    rig = Rig(wait_s=wait_s)
    rig.silent = {"afm_node@slave"}
    hint = "a person has to release: `telenano session arm --target afm_node`"

    def refuse(count: int) -> None:
        for _ in range(count):
            rig.tick(1)
            facts = {"command": "arm", "latch": "5d0c-1", "latched": True, "estop_age_s": 1000.0}
            rig.receive_event("afm_node@slave", "refused", answer_to=rig.bus.controls()[-1].id, **facts)

    rig.all_ready()
    rig.tick(1)
    refuse(300)
    assert not rig.session.failure
    assert hint in rig.session.status_line()
    assert sum(hint in line for line in rig.reports) == 1
    # a second one is as often as a person needs
    assert len({control.id for control in rig.bus.controls()}) < 20
    if wait_s is not None:
        refuse(120)
        assert rig.session.failure.endswith("; it was not done within 20 s")
        return
    rig.silent = set()
    rig.tick(30)
    assert rig.session.ran


def test_a_device_that_becomes_able_is_asked_again() -> None:
    rig = Rig()
    rig.refusing = {"afm_node@slave"}
    rig.all_ready()
    rig.tick(20)
    rig.refusing = set()
    rig.tick(20)
    assert rig.session.ran
    asked = [control.id for control in rig.bus.controls() if control.target == "afm_node"]
    # a command of its own each time: a node carries an id out only once
    assert 2 < len(set(asked)) < 10


def test_what_is_not_ready_in_time_is_named_with_its_missing_input_and_its_log() -> None:
    rig = Rig()
    rig.all_ready()
    rig.receive(health("afm_node@slave", inputs=(row("afm/command", received=False),)), "node/health")
    rig.tick(round(READY_DEADLINE_S * SECOND_NS / TICK_NS) - 1)
    assert not rig.finished
    rig.tick(2)
    assert rig.finished
    assert "afm_node@slave does not receive afm/command" in rig.session.failure
    assert "the log tail of afm_node@slave" in rig.session.failure
    assert "recorder@master" not in rig.session.failure


def test_an_exit_is_published_and_the_node_comes_back() -> None:
    rig = Rig()
    rig.all_ready()
    rig.tick(4)
    rig.children.ended = {"afm_node@slave": -9}
    rig.tick(1)
    ended = rig.bus.events()[-1]
    assert (ended.kind, ended.level) == ("node", "warning")
    assert "killed by SIGKILL" in ended.text
    assert ended.data["exit_code"] == -9
    assert "afm_node@slave" not in rig.session.health
    rig.tick(3)
    assert rig.children.started == [*NODES, "afm_node@slave"]
    assert rig.bus.events()[-1].text == "afm_node@slave was started again"
    assert rig.session.phase == "running"
    assert rig.session.supervisor.restarts()["afm_node@slave"] == 1


def test_a_crash_loop_ends_the_rig_with_the_cause() -> None:
    rig = Rig(duration_s=1000.0)
    rig.all_ready()
    rig.tick(4)
    rig.children.ended = {"recorder@master": -15}
    rig.tick(4)
    for code in (-9, 1, 1, 1, 1):
        rig.children.ended = {"afm_node@slave": code}
        rig.tick(30)
    assert rig.finished
    what, exits, others, where, words = rig.session.failure.splitlines()
    assert what.startswith("afm_node@slave ended with exit code 1 after ")
    assert what.endswith("it died 5 times within 30 s")
    assert exits.startswith("its last 5 exits: was killed by SIGKILL after 0.5 s, ended with exit code 1 after ")
    assert others == "other nodes that were started again: recorder@master (1)"
    assert where == "last lines of afm_node@slave, from logs/afm_node@slave.log:"
    assert words == "the log tail of afm_node@slave"


class Taken:
    """A path of the launcher that another process has, or that can be had again."""

    def __init__(self, error: str) -> None:
        self.error = error
        self.is_lost = True

    def lost(self) -> str:
        return "/run/x" if self.is_lost else ""

    def make_again(self) -> None:
        if self.error:
            raise EndpointError(self.error)
        self.is_lost = False


@pytest.mark.parametrize("error", ["another user has it", ""])
def test_a_rig_that_no_command_reaches_any_more_makes_its_devices_safe_and_ends(error: str) -> None:
    rig = Rig(duration_s=1000.0)
    rig.all_ready()
    rig.tick(4)
    rig.context.places = Places()
    rig.context.places.add(Taken(error))
    # A loop looks twice a second: at the second look in a row a device stops, and at the fourth the rig ends.
    for _ in range(3):
        rig.context.places.look()
        rig.tick_alive(2)
        assert not rig.finished
    rig.context.places.look()
    rig.tick_alive(2)
    assert rig.finished == bool(error)
    if error:
        assert rig.session.failure.startswith(f"no command reaches this rig any more: {error}; its devices were made")
        assert not rig.children.stopped
        rig.session.make_safe()
        assert rig.children.stopped


def test_a_node_that_cannot_start_ends_the_rig_at_once() -> None:
    rig = Rig()
    rig.children.ended = {"haptic_node@master": 2}
    rig.tick(1)
    assert rig.finished
    assert "the log tail of haptic_node@master" in rig.session.failure
    assert rig.children.started == NODES


@pytest.mark.parametrize(("ready", "commands"), [(False, []), (True, ["arm", "arm", "start", "stop"])])
def test_an_interruption_stops_the_programme_only_where_it_runs(ready: bool, commands: list[str]) -> None:
    rig = Rig()
    if ready:
        rig.all_ready()
    rig.tick(5)
    rig.session.interrupt()
    rig.tick(2)
    assert rig.finished
    assert rig.session.failure == ""
    assert [control.command for control in rig.bus.controls()] == commands


def test_a_hand_that_is_gone_does_not_keep_the_rig_from_stopping() -> None:
    rig = Rig()
    rig.all_ready()
    rig.tick(5)
    rig.silent = {"haptic_node@master"}
    rig.session.interrupt()
    rig.tick(39)
    assert not rig.finished
    rig.tick(3)
    assert rig.finished


@pytest.mark.parametrize(
    ("node_health", "reason"),
    [
        (None, "has not reported yet"),
        (health("recorder@master", "starting"), "is still starting"),
        (health("recorder@master", inputs=(row("haptic/state", received=False),)), "does not receive haptic/state"),
        # sent on change only: silence means nothing
        (health("recorder@master", inputs=(row("session/control", received=False),)), None),
        # received at one of its sockets
        (
            health("recorder@master", inputs=(row("afm/state", received=False), row("afm/state", "afm_node@slave"))),
            None,
        ),
        (health("recorder@master", "safe"), None),
    ],
)
def test_readiness(node_health: NodeHealth | None, reason: str | None) -> None:
    known = {} if node_health is None else {"recorder@master": node_health}
    assert unmet(["recorder@master"], known) == ({} if reason is None else {"recorder@master": reason})


def test_inputs_at_a_declared_rate_are_what_counts() -> None:
    inputs = (
        row("afm/state", "a@b", age_s=0.3),
        row("session/event", "a@b", age_s=9.0),
        row("node/health", "a@b", age_s=0.5),
        row("haptic/state", received=False),
    )
    assert oldest_input_s(health("x@y", inputs=inputs)) == 0.3
    assert silent_inputs(health("x@y", inputs=inputs)) == ["haptic/state"]
    assert oldest_input_s(health("x@y")) is None


def test_the_live_view_draws_every_phase() -> None:
    rig = Rig()
    texts = []
    for action in (lambda: None, rig.all_ready, rig.session.interrupt):
        texts.append(rig.session.status_line())
        assert rig_picture(rig.session).renderables
        action()
        rig.tick(4)
    assert texts[0].startswith("waiting for 3 of 3 nodes")
    assert "running for 2 s" in texts[2]


def test_the_live_view_has_the_health_of_each_node_under_its_heading() -> None:
    rig = Rig()
    found = health("afm_node@slave", "safe", inputs=(row("afm/command", "a@b", age_s=0.5),), uptime_s=3.0)
    rig.receive(msgspec.structs.replace(found, rejected={"source": 3}, memory_bytes=57_000_000), "node/health")
    text = StringIO()
    Console(file=text, width=140).print(nodes_table(rig.session))
    cells = [[cell.strip() for cell in line.strip("┃│").split(line[0])] for line in text.getvalue().splitlines()]
    headings = next(line for line in cells if line[0] == "node")
    rows = {line[0]: dict(zip(headings, line, strict=False)) for line in cells}
    assert rows["afm_node@slave"] == {
        "node": "afm_node@slave", "state": "safe", "rate Hz": "1000.0", "late p99 ms": "0.000", "input age ms": "500.0",
        "lost": "0", "refused": "source 3", "CPU %": "1", "MB": "57", "files": "-", "restarts": "0",
    }  # fmt: skip
    assert rows["haptic_node@master"]["state"] == "-"


def test_what_happens_to_the_recording_is_shown_once() -> None:
    rig = Rig()
    rig.all_ready()
    rig.tick(4)
    for level, state, text in (
        ("warning", "disk_low", "10 MB left"),
        ("warning", "disk_low", "9 MB left"),
        ("error", "failed", "the disk is full"),
        ("error", "failed", "the disk is full"),
    ):
        rig.receive_event("recorder@master", "recording", text, level=level, state=state, path="x")
    rig.tick(1)
    assert rig.reports == ["recorder@master: 10 MB left", "recorder@master: the disk is full"]
    assert rig.session.recording_faults == {"recorder@master": "the disk is full"}


def test_while_nodes_are_stopped_it_is_reported_what_takes_its_time() -> None:
    rig = Rig()
    rig.all_ready()
    rig.tick(4)
    ending = _Ending(rig.session)
    assert not ending.has_ended("afm_node@slave")
    data = {"state": "ended", "sent.afm/state": 5}
    event = SessionEvent(
        seq=0, t_ns=0, src="afm_node@slave", v=1, id="", kind="node", level="info", text="e", data=data
    )
    rig.bus.waiting.append(Received("session/event", event, b"", 0, Arrival.NEXT))
    ending.wait(["afm_node@slave", "haptic_node@master"], 0.2, 22.0)
    assert ending.has_ended("afm_node@slave")
    behind = (row("session/event", "afm_node@slave", age_s=0.2),)
    rig.receive_health("recorder@master", inputs=behind)
    for waited_s in (0.4, 1.1, 1.4, 2.0):
        ending.wait(["afm_node@slave"], waited_s, 22.0)
    rig.receive_health("recorder@master", inputs=(row("session/event", "afm_node@slave", age_s=0.0),))
    ending.wait(["afm_node@slave"], 3.0, 22.0)
    ending.wait(["recorder@master"], 4.0, 30.0)
    rig.take_news(rig.session)
    assert rig.reports == [
        "saving the last messages of afm_node@slave (the recorder is behind): 1 s, at most 22 s",
        "saving the last messages of afm_node@slave (the recorder is behind): 2 s, at most 22 s",
        "waiting for the end of afm_node@slave: 3 s, at most 22 s",
        "waiting for the end of recorder@master: 4 s, at most 30 s",
    ]
    # one that reports again was started again
    rig.receive_health("afm_node@slave")
    assert not ending.has_ended("afm_node@slave")


LAST = {"state": "ended", "sent.session/event": 5}
FAR_RECORDER = "recorder@slave"


@pytest.mark.parametrize("publisher", ["viz_node@master", "afm_node@slave", "delay_node@master"])
@pytest.mark.parametrize(
    ("reader", "ages_s", "gone", "delivered"),
    [
        ("has it", {"recorder@master": 0.0}, (), True),
        # the row is of an event before the last one
        ("late", {"recorder@master": 0.01}, (), False),
        # its newest report is from before the end, and so is what it says of every publisher
        ("busy or stopped", {"recorder@master": 3.0}, (), False),
        ("gone", {"recorder@master": 3.0}, ("recorder@master",), True),
        ("none that receives it", {}, (), True),
        ("one of two late", {"recorder@master": 0.0, FAR_RECORDER: 0.5}, (), False),
        ("one of two gone", {"recorder@master": 0.5, FAR_RECORDER: 0.0}, ("recorder@master",), True),
    ],
)
def test_a_publisher_is_waited_for_as_long_as_a_recorder_lacks_its_last_message(
    publisher: str, reader: str, ages_s: dict[str, float], gone: tuple[str, ...], delivered: bool
) -> None:
    rig = Rig()
    ending = _Ending(rig.session)
    # a link publishes at both of its ends, each with a last message of its own
    for src in [*(["delay_node@slave"] if publisher == "delay_node@master" else []), publisher]:
        assert not ending.has_delivered(publisher, gone)
        rig.receive_event(src, "node", **LAST)
    rig.receive_health("recorder@master")
    for recorder, age_s in ages_s.items():
        rig.receive_health(recorder, inputs=(row("session/event", publisher, age_s=age_s),))
    assert ending.has_delivered(publisher, gone) is delivered
    # one that has no last message yet is still at work
    assert not ending.has_delivered("haptic_node@master", gone)


def test_what_a_device_warns_of_while_it_is_armed_is_shown_by_up() -> None:
    rig = Rig()
    rig.all_ready()
    rig.session.phase = "arming"
    text = "a hand cannot touch the sample here"
    rig.receive_event("afm_node@slave", "fault", text, level="warning")
    rig.receive_event("afm_node@slave", "mode", "its middle is at 0")
    assert list(rig.session.reports) == [f"afm_node@slave: {text}"]
    # later ones are events of the session, which the view lists by themselves
    rig.session.phase = "running"
    rig.receive_event("afm_node@slave", "fault", text, level="warning")
    assert len(rig.session.reports) == 1

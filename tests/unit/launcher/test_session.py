from dataclasses import dataclass, field
from typing import Any

import pytest

from proto import TOPICS
from proto.messages import InputHealth, Message, NodeHealth, SessionControl, SessionEvent
from services.launcher.readiness import oldest_input_s, silent_inputs, unmet
from services.launcher.session import READY_DEADLINE_S, SessionNode
from services.launcher.view import phase_text, session_picture
from services.runtime.bus import Received
from services.runtime.clock import VirtualClock
from services.runtime.log import StructuredLog
from services.runtime.node import NodeContext
from services.runtime.sequence import Arrival

NODES = ["recorder@master", "afm_node@slave", "haptic_node@master"]
TICK_NS = 50_000_000
SECOND_NS = 1_000_000_000


def row(topic: str, src: str = "", *, heard: bool = True, age_s: float = 0.001) -> InputHealth:
    return InputHealth(
        topic=topic, src=src, received=int(heard), lost=0, gaps=0, repeated=0, restarts=0, age_valid=heard, age_s=age_s
    )


def health(node: str, state: str = "ready", inputs: tuple[InputHealth, ...] = ()) -> NodeHealth:
    fields: dict[str, Any] = {
        "seq": 0, "t_ns": 0, "src": node, "v": 1, "pid": 1, "state": state, "uptime_s": 1.0, "rate_hz": 1000.0,
        "period_s": 0.001, "lateness_p50_s": 0.0, "lateness_p99_s": 0.0, "lateness_max_s": 0.0, "overruns": 0,
        "rejected": {}, "cpu_percent": 1.0, "memory_bytes": 1, "realtime": False, "memory_locked": False,
        "replay": False, "inputs": inputs,
    }  # fmt: skip
    return NodeHealth(**fields)


@dataclass
class FakeBus:
    clock: VirtualClock
    sent: list[Message] = field(default_factory=list)

    def publish(self, topic: str, **fields: Any) -> Message:
        message = TOPICS[topic].model(
            seq=len(self.sent), t_ns=self.clock.now_ns(), src="launcher@master", v=1, **fields
        )
        self.sent.append(message)
        return message

    def receive(self) -> Any:
        raise NotImplementedError

    def wait(self, deadline_ns: int) -> None:
        raise NotImplementedError

    def controls(self) -> list[SessionControl]:
        return [message for message in self.sent if isinstance(message, SessionControl)]

    def events(self) -> list[SessionEvent]:
        return [message for message in self.sent if isinstance(message, SessionEvent)]


@dataclass
class FakeChildren:
    started: list[str] = field(default_factory=list)
    ended: dict[str, int] = field(default_factory=dict)
    stopped: int = 0

    def start(self, node: str) -> int:
        self.started.append(node)
        return len(self.started)

    def reap(self) -> dict[str, int]:
        ended, self.ended = self.ended, {}
        return ended

    def log_tail(self, node: str) -> str:
        return f"the last words of {node}"

    def stop(self) -> None:
        self.stopped += 1


class Rig:
    """A session in virtual time, with nodes that answer what they know unless they are told to be silent."""

    def __init__(self, duration_s: float = 2.0) -> None:
        self.clock = VirtualClock(start_ns=SECOND_NS)
        self.bus = FakeBus(self.clock)
        self.children = FakeChildren()
        context = NodeContext("launcher@master", self.clock, self.bus, StructuredLog("launcher@master"))
        self.session = SessionNode(context, NODES, self.children, duration_s)
        self.finished = False
        self.session.finish = self.finish
        self.silent: set[str] = set()
        self.refusing: set[str] = set()
        self.answered = 0
        self.session.launch()

    def finish(self) -> None:
        self.finished = True

    def hear(self, message: Message, topic: str) -> None:
        self.session.on_message(Received(topic, message, b"", self.clock.now_ns(), Arrival.NEXT))

    def all_ready(self) -> None:
        for node in NODES:
            self.hear(health(node), "node/health")

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.clock.advance_ns(TICK_NS)
            self.session.on_deadline(self.clock.monotonic_ns())
            self.answer()

    def answer(self) -> None:
        controls = self.bus.controls()
        for control in controls[self.answered :]:
            known = {"arm": {control.target + "@slave", control.target + "@master"} & set(NODES)}
            for node in known.get(control.command, {"haptic_node@master"}) - self.silent:
                kind: Any = "refused" if node in self.refusing else "ack"
                event = SessionEvent(
                    seq=0, t_ns=0, src=node, v=1, id=control.id, kind=kind, level="info", text="said", data={}
                )
                self.hear(event, "session/event")
        self.answered = len(controls)


def test_a_whole_session() -> None:
    rig = Rig(duration_s=2.0)
    assert rig.children.started == NODES
    rig.tick(5)
    assert rig.session.phase == "starting"
    assert rig.bus.controls() == []
    rig.all_ready()
    rig.tick(4)
    assert rig.session.phase == "running"
    assert [(c.command, c.target) for c in rig.bus.controls()] == [
        ("arm", "afm_node"),
        ("arm", "haptic_node"),
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
    assert rig.session.failure == "afm_node@slave refused arm: said"


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
    rig.hear(health("afm_node@slave", inputs=(row("afm/command", heard=False),)), "node/health")
    rig.tick(round(READY_DEADLINE_S * SECOND_NS / TICK_NS) - 1)
    assert not rig.finished
    rig.tick(2)
    assert rig.finished
    assert "afm_node@slave does not hear afm/command" in rig.session.failure
    assert "the last words of afm_node@slave" in rig.session.failure
    assert "recorder@master" not in rig.session.failure


def test_a_death_is_published_and_the_node_comes_back() -> None:
    rig = Rig()
    rig.all_ready()
    rig.tick(4)
    rig.children.ended = {"afm_node@slave": -9}
    rig.tick(1)
    death = rig.bus.events()[-1]
    assert (death.kind, death.level) == ("node", "warning")
    assert "killed by SIGKILL" in death.text
    assert death.data["exit_code"] == -9
    assert "afm_node@slave" not in rig.session.health
    rig.tick(3)
    assert rig.children.started == [*NODES, "afm_node@slave"]
    assert rig.bus.events()[-1].text == "afm_node@slave was started again"
    assert rig.session.phase == "running"
    assert rig.session.supervisor.restarts("afm_node@slave") == 1


def test_a_crash_loop_ends_the_rig_with_the_cause() -> None:
    rig = Rig(duration_s=1000.0)
    rig.all_ready()
    rig.tick(4)
    for _ in range(5):
        rig.children.ended = {"afm_node@slave": 1}
        rig.tick(30)
    assert rig.finished
    assert "5 times within 30 s" in rig.session.failure
    assert "exit code 1" in rig.session.failure
    assert "the last words of afm_node@slave" in rig.session.failure


def test_a_node_that_cannot_start_ends_the_rig_at_once() -> None:
    rig = Rig()
    rig.children.ended = {"haptic_node@master": 2}
    rig.tick(1)
    assert rig.finished
    assert "the last words of haptic_node@master" in rig.session.failure
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
        (None, "has not been heard"),
        (health("recorder@master", "starting"), "is still starting"),
        (health("recorder@master", inputs=(row("haptic/state", heard=False),)), "does not hear haptic/state"),
        # sent on change only: silence means nothing
        (health("recorder@master", inputs=(row("session/control", heard=False),)), None),
        # heard at one of its sockets
        (health("recorder@master", inputs=(row("afm/state", heard=False), row("afm/state", "afm_node@slave"))), None),
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
        row("haptic/state", heard=False),
    )
    assert oldest_input_s(health("x@y", inputs=inputs)) == 0.3
    assert silent_inputs(health("x@y", inputs=inputs)) == ["haptic/state"]
    assert oldest_input_s(health("x@y")) is None


def test_the_live_view_draws_every_phase() -> None:
    rig = Rig()
    texts = []
    for action in (lambda: None, rig.all_ready, rig.session.interrupt):
        texts.append(phase_text(rig.session))
        assert session_picture(rig.session).renderables
        action()
        rig.tick(4)
    assert texts[0].startswith("waiting for 3 of 3 nodes")
    assert "running for 2 s" in texts[2]

"""A session of the launcher in virtual time, whose nodes answer their commands unless a test makes them silent."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from telenano.launcher.external_recording import ExternalRecording
from telenano.launcher.processes import StopObserver
from telenano.launcher.rig_node import RigNode
from telenano.launcher.session import SessionNode
from telenano.launcher.supervisor import Supervisor
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import NodeContext
from telenano.testing import VirtualClock
from telenano.wire.messages import InputHealth, Message, NodeHealth, SessionControl, SessionEvent
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival
from telenano.wire.topics import TOPICS

NODES = ["recorder@master", "afm_node@slave", "haptic_node@master"]
TICK_NS = 50_000_000
SECOND_NS = 1_000_000_000


def row(topic: str, src: str = "", *, received: bool = True, age_s: float = 0.001) -> InputHealth:
    return InputHealth(
        topic=topic,
        src=src,
        received=int(received),
        lost=0,
        gaps=0,
        repeated=0,
        restarts=0,
        age_valid=received,
        age_s=age_s,
    )


def health(node: str, state: str = "ready", inputs: tuple[InputHealth, ...] = (), uptime_s: float = 1.0) -> NodeHealth:
    fields: dict[str, Any] = {
        "seq": 0, "t_ns": 0, "src": node, "v": 1, "pid": 1, "state": state, "uptime_s": uptime_s, "rate_hz": 1000.0,
        "period_s": 0.001, "lateness_p50_s": 0.0, "lateness_p99_s": 0.0, "lateness_max_s": 0.0, "overruns": 0,
        "rejected": {}, "cpu_percent": 1.0, "memory_bytes": 1, "realtime": False, "memory_locked": False,
        "replay": False, "inputs": inputs,
    }  # fmt: skip
    return NodeHealth(**fields)


@dataclass
class FakeBus:
    clock: VirtualClock
    key: str
    sent: list[Message] = field(default_factory=list)
    waiting: list[Received] = field(default_factory=list)

    def publish(self, topic: str, **fields: Any) -> Message:
        message = TOPICS[topic].model(seq=len(self.sent), t_ns=self.clock.now_ns(), src=self.key, v=1, **fields)
        self.sent.append(message)
        return message

    def receive(self) -> Any:
        waiting, self.waiting = self.waiting, []
        yield from waiting

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
    killed: list[str] = field(default_factory=list)
    tails: dict[str, str] = field(default_factory=dict)
    stopped: int = 0

    def start(self, node: str) -> int:
        self.started.append(node)
        return len(self.started)

    def reap(self) -> dict[str, int]:
        ended, self.ended = self.ended, {}
        return ended

    def kill(self, node: str) -> None:
        self.killed.append(node)
        self.ended[node] = -9

    def log_tail(self, node: str) -> str:
        return self.tails.get(node, f"the log tail of {node}")

    def log_path(self, node: str) -> Path:
        return Path("logs") / f"{node}.log"

    def stop(self, observer: StopObserver) -> None:
        self.stopped += 1
        observer.wait((), 0.0, 1.0)


class Bench:
    """A launcher in virtual time: the messages that it receives, and those that it sends."""

    node: RigNode

    def __init__(self, key: str = "launcher@master") -> None:
        self.clock = VirtualClock(start_ns=SECOND_NS, epoch_offset_ns=10**18)
        self.bus = FakeBus(self.clock, key)
        self.children = FakeChildren()
        self.context = NodeContext(key, self.clock, self.bus, StructuredLog(key))
        # Every line that the launcher has reported.
        self.reports: list[str] = []

    def begin(self, node: RigNode) -> None:
        self.node = node
        node.observe = self.take_news
        node.launch()

    @property
    def finished(self) -> bool:
        return self.context.stop_requested

    def take_news(self, node: RigNode) -> None:
        while node.reports:
            self.reports.append(node.reports.popleft())

    def receive(self, message: Message, topic: str) -> None:
        self.node.on_message(Received(topic, message, b"", self.clock.now_ns(), Arrival.NEXT))

    def receive_health(self, *nodes: str, **fields: Any) -> None:
        for node in nodes:
            self.receive(health(node, **fields), "node/health")

    def receive_event(
        self, src: str, kind: Any, text: str = "reason", answer_to: str = "", level: Any = "info", **data: Any
    ) -> None:
        event = SessionEvent(seq=0, t_ns=0, src=src, v=1, id=answer_to, kind=kind, level=level, text=text, data=data)
        self.receive(event, "session/event")

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            self.clock.advance_ns(TICK_NS)
            self.node.on_deadline(self.clock.monotonic_ns())
            self.after_tick()

    def after_tick(self) -> None:
        """Do the work of the rig's nodes in a tick."""


class Rig(Bench):
    """A session with its nodes: `own` are children of the launcher, `others` run elsewhere."""

    def __init__(
        self,
        duration_s: float = 2.0,
        own: Sequence[str] = NODES,
        others: Sequence[str] = (),
        recorder: str = "",
        **options: Any,
    ) -> None:
        super().__init__()
        recording = ExternalRecording(self.clock, recorder) if recorder else None
        self.silent: set[str] = set()
        self.refusing: set[str] = set()
        # Whether the tip reports that it is placed after it was armed.
        self.places = True
        self.answered = 0
        self.rig_nodes = [*own, *others]
        self.session = SessionNode(
            self.context,
            Supervisor(self.clock, own, self.children),
            duration_s,
            others=others,
            recording=recording,
            **options,
        )
        self.begin(self.session)

    def all_ready(self) -> None:
        self.receive_health(*self.rig_nodes)

    def tick_alive(self, count: int = 1, missing: Sequence[str] = ()) -> None:
        """Let time pass with reports of every node except the missing ones."""
        for _ in range(count):
            self.receive_health(*(node for node in self.rig_nodes if node not in missing))
            self.tick()

    def after_tick(self) -> None:
        controls = self.bus.controls()
        for control in controls[self.answered :]:
            named = {control.target + "@slave", control.target + "@master"}
            known = {"arm": named, "estop": named, "set": {control.target}}
            # Only the hand obeys a `stop` to a pattern, by which it ends its programme.
            known["stop"] = {"haptic_node@master"} if control.target == "*" else named
            concerned = known.get(control.command, {"haptic_node@master"}) & set(self.rig_nodes)
            for node in concerned - self.silent:
                kind = "refused" if node in self.refusing else "ack"
                self.receive_event(node, kind, answer_to=control.id)
                if (kind, control.command, node) == ("ack", "arm", "afm_node@slave") and self.places:
                    self.receive_event(node, "mode", "the tip is placed", placed=True)
        self.answered = len(controls)

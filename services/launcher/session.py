"""The launcher as a node of the bus: brings the rig up, runs the session, and takes everything down again."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from proto.messages import NodeHealth, Scalar, SessionEvent
from services.launcher.control import Command, PendingControl
from services.launcher.processes import Children
from services.launcher.readiness import unmet
from services.launcher.supervisor import Death, Supervisor, ending
from services.runtime.bus import Received
from services.runtime.node import Node, NodeContext
from services.runtime.schedule import Grid

Phase = Literal["starting", "arming", "running", "ending", "over"]

TICK_S = 0.05
READY_DEADLINE_S = 60.0
# what a stopping rig waits for the answer to `stop`; the devices make themselves safe on SIGTERM in any case
_STOP_ANSWER_NS = 2_000_000_000
_REMEMBERED_EVENTS = 8
# a refusal at the start is asked about again for so long, so often
_REFUSAL_PATIENCE_NS = 5_000_000_000
_ASK_AGAIN_NS = 300_000_000


@dataclass(frozen=True)
class Step:
    """A command of the session and who has to answer it."""

    command: Command
    target: str
    expected: tuple[str, ...]


# the instrument before the hand, so that the hand never moves a reference that nothing follows
BEGIN = (
    Step("arm", "afm_node", ("afm_node@slave",)),
    Step("arm", "haptic_node", ("haptic_node@master",)),
    Step("start", "*", ("haptic_node@master",)),
)
END = Step("stop", "*", ("haptic_node@master",))


class SessionNode(Node):
    """Supervises the processes and conducts the session: start, arm, run, stop."""

    inputs: ClassVar[tuple[str, ...]] = ("session/event", "node/health")
    period_s = TICK_S

    def __init__(
        self,
        context: NodeContext,
        nodes: Sequence[str],
        children: Children,
        duration_s: float,
        *,
        observe: Callable[["SessionNode"], None] = lambda session: None,
    ) -> None:
        """Take the nodes in the order of their start; `observe` is called each tick, for the live view."""
        super().__init__(context)
        self.nodes = list(nodes)
        self.duration_s = duration_s
        self.supervisor = Supervisor(context.clock, nodes)
        self.health: dict[str, NodeHealth] = {}
        self.events: deque[SessionEvent] = deque(maxlen=_REMEMBERED_EVENTS)
        self.phase: Phase = "starting"
        self.failure = ""
        self.interrupted = False
        self.finish: Callable[[], None] = lambda: None
        self.state = "starting"
        self._children = children
        self._observe = observe
        self._begun_ns = self.clock.monotonic_ns()
        self._running_ns: int | None = None
        self._grid = Grid(self._begun_ns, round(TICK_S * 1e9))
        # a device that somebody else runs is not ours to arm, and its operator starts without us
        self._steps = deque(step for step in BEGIN if set(step.expected) <= set(nodes))
        self._pending: PendingControl | None = None
        self._step = BEGIN[0]
        self._patient_until_ns = self._ask_again_ns = 0

    def launch(self) -> None:
        """Start every node for the first time."""
        for node in self.nodes:
            self._start(node)

    def interrupt(self) -> None:
        """End the session early, as Ctrl-C and SIGTERM do."""
        self.interrupted = True

    @property
    def elapsed_s(self) -> float:
        """Time since the operator's programme started [s]; 0 before that."""
        if self._running_ns is None:
            return 0.0
        return (self.clock.monotonic_ns() - self._running_ns) * 1e-9

    @property
    def ran(self) -> bool:
        """Say whether the operator's programme was started."""
        return self._running_ns is not None

    def waiting(self) -> dict[str, str]:
        """Give for each node that is not ready what it waits for."""
        return unmet(self.nodes, self.health)

    def deadline_ns(self) -> int:
        """Give the time of the next look at processes and phase [ns]."""
        return self._grid.deadline_ns

    def on_message(self, received: Received) -> None:
        """Take what the nodes say of themselves."""
        message = received.message
        if isinstance(message, NodeHealth):
            self.health[message.src] = message
        elif isinstance(message, SessionEvent):
            self.events.append(message)
            if self._pending is not None:
                self._pending.enter(message)

    def on_deadline(self, now_ns: int) -> None:
        """Look after the processes and take the session a step further."""
        self._grid.advance(now_ns)
        self.overruns = self._grid.overruns
        self.steps += 1
        self._look_after_processes()
        self._advance()
        self._observe(self)

    def make_safe(self) -> None:
        """Take the rig down in order; also when the launcher itself failed."""
        self.phase = "over"
        self._children.stop()

    def _start(self, node: str) -> int:
        process_id = self._children.start(node)
        self.supervisor.started(node)
        return process_id

    def _look_after_processes(self) -> None:
        for node, exit_code in self._children.reap().items():
            self.health.pop(node, None)
            self._bury(self.supervisor.died(node, exit_code))
        if self.failure or self.phase == "ending":
            return
        for node in self.supervisor.due():
            process_id = self._start(node)
            self._say("warning", f"{node} was started again", about_node=node, pid=process_id)

    def _bury(self, death: Death) -> None:
        text = f"{death.node} {ending(death.exit_code)} after {death.life_s:.1f} s: {death.verdict}"
        level: Literal["warning", "error"] = "error" if death.given_up else "warning"
        self._say(level, text, about_node=death.node, exit_code=death.exit_code, life_s=death.life_s)
        if death.given_up:
            self._fail(f"{text}\n{self._last_words(death.node)}")

    def _last_words(self, node: str) -> str:
        return f"last lines of {node}:\n{self._children.log_tail(node) or '(it wrote nothing)'}"

    def _say(self, level: str, text: str, **data: Scalar) -> None:
        self.event("node", level, text, answer_to="", **data)

    def _fail(self, text: str) -> None:
        # the first failure is the cause, what follows are its consequences
        self.failure = self.failure or text

    def _advance(self) -> None:
        if self.phase in ("starting", "arming", "running") and (self.failure or self.interrupted):
            self._end()
        elif self.phase == "starting":
            self._advance_start()
        elif self.phase == "arming":
            self._advance_begin()
        elif self.phase == "running" and self.elapsed_s >= self.duration_s:
            self._end()
        elif self.phase == "ending":
            self._advance_end()

    def _advance_start(self) -> None:
        waiting = self.waiting()
        if not waiting:
            self.phase = "arming"
            self._advance_begin()
        elif self.clock.monotonic_ns() - self._begun_ns >= READY_DEADLINE_S * 1e9:
            reasons = "; ".join(f"{node} {reason}" for node, reason in waiting.items())
            text = f"the rig was not ready within {READY_DEADLINE_S:g} s: {reasons}"
            self._fail("\n".join([text, *(self._last_words(node) for node in waiting)]))

    def _advance_begin(self) -> None:
        pending = self._pending
        if pending is None and not self._steps:
            self._run()
            return
        if pending is None:
            step = self._step = self._steps.popleft()
            pending = self._pending = PendingControl(self.clock, step.command, step.target, step.expected)
            self._patient_until_ns = self.clock.monotonic_ns() + _REFUSAL_PATIENCE_NS
        if failure := pending.failure():
            self._ask_again(failure)
        elif pending.complete:
            self._pending = None
            if self._steps:
                self._advance_begin()
            else:
                self._run()
        elif pending.take_due():
            self.publish("session/control", **pending.fields())

    def _ask_again(self, failure: str) -> None:
        """Give a device some time to become able: its first fresh command may still be on the way."""
        now = self.clock.monotonic_ns()
        if self._pending is None or not self._pending.refusals or now >= self._patient_until_ns:
            self._fail(failure)
        elif now >= self._ask_again_ns:
            step = self._step
            self._pending = PendingControl(self.clock, step.command, step.target, step.expected)
            self._ask_again_ns = now + _ASK_AGAIN_NS

    def _run(self) -> None:
        self._running_ns = self.clock.monotonic_ns()
        self.phase = "running"
        self.state = "running"
        self._say("info", "the session is running", duration_s=self.duration_s)

    def _end(self) -> None:
        """Ask for the end of the operator's programme, where one is running and can still be asked."""
        self.phase = "ending"
        stoppable = self.ran and not self.failure
        expected = tuple(node for node in END.expected if node in self.nodes) if stoppable else ()
        self._pending = PendingControl(self.clock, END.command, END.target, expected, deadline_ns=_STOP_ANSWER_NS)
        self._advance_end()

    def _advance_end(self) -> None:
        pending = self._pending
        if pending is None or pending.complete or pending.failure():
            self._say("info", "the session is over, the nodes are stopped", interrupted=self.interrupted)
            self.finish()
        elif pending.take_due():
            self.publish("session/control", **pending.fields())

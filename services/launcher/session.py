"""The launcher as a node of the bus: what it shows of a rig, and the session that it conducts."""

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import ClassVar, Literal

from proto.messages import ClockPing, NodeHealth, Scalar, SessionEvent
from proto.nodes import HAND, TIP
from services.launcher.command_sequence import CommandSequence, Step
from services.launcher.external_recording import ExternalRecording
from services.launcher.liveness import Change, Watch
from services.launcher.readiness import READY_DEADLINE_S, ReadinessGate, unmet
from services.launcher.supervisor import Supervisor
from services.runtime.bus import Received
from services.runtime.deadlines import PeriodicDeadline
from services.runtime.node import Node, NodeContext

Phase = Literal["starting", "arming", "running", "ending", "over"]

TICK_S = 0.05
# what a stopping rig waits for the answer to `stop`; the devices make themselves safe on SIGTERM in any case
_STOP_ANSWER_NS = 2_000_000_000
_REMEMBERED_EVENTS = 8

# the instrument before the hand, so that the hand never moves a reference that nothing follows
BEGIN = (
    Step("arm", "afm_node", (TIP,)),
    Step("arm", "haptic_node", (HAND,)),
    Step("start", "*", (HAND,)),
)
END = Step("stop", "*", (HAND,), required=False, deadline_ns=_STOP_ANSWER_NS)
# where the nodes go on without a session the tip must not stay on the sample with nobody at the controls
LEAVE = Step("estop", "afm_node", (TIP,), required=False, deadline_ns=_STOP_ANSWER_NS)
# what the operator has to do when a device was lost and is back; {at} says at which site, where there are two
_AGAIN = {
    TIP: "a tip that has retracted stays so until `telenano session arm --target afm_node{at}`",
    HAND: "a hand that was restarted stays free until `telenano session arm --target haptic_node{at}`, "
    "its programme until `telenano session start{at}`",
}


class RigNode(Node):
    """What is seen of a rig from here: own processes, which are kept running, and the nodes of somebody else."""

    inputs: ClassVar[tuple[str, ...]] = ("session/event", "node/health")
    period_s = TICK_S

    def __init__(
        self, context: NodeContext, keeper: Supervisor, watch: Watch, others: Sequence[str], site: str = ""
    ) -> None:
        """Prepare to look after a rig.

        Parameters: keeper, of own nodes; watch, over those whose silence is told; others, nodes of somebody else;
        site, the one that this is, empty where both are one.
        """
        super().__init__(context)
        self.keeper = keeper
        self.watch = watch
        self.site = site
        self.nodes = [*keeper.nodes, *others]
        self.health: dict[str, NodeHealth] = {}
        self.events: deque[SessionEvent] = deque(maxlen=_REMEMBERED_EVENTS)
        # sentences for whoever looks on, who takes them away
        self.news: deque[str] = deque(maxlen=64)
        self.phase: Phase = "starting"
        self.interrupted = False
        self.observe: Callable[[RigNode], None] = lambda node: None
        self.state = "starting"
        self._failure = ""
        self._grid = PeriodicDeadline(self.clock.monotonic_ns(), round(TICK_S * 1e9))

    def launch(self) -> None:
        """Start every own node for the first time."""
        self.keeper.launch()

    def interrupt(self) -> None:
        """End early, as Ctrl-C and SIGTERM do."""
        self.interrupted = True

    @property
    def failure(self) -> str:
        """Say why the rig cannot go on; empty while it can."""
        return self.keeper.failure or self._failure

    @abstractmethod
    def waiting(self) -> dict[str, str]:
        """Give for each node that is not ready what it waits for."""

    def causes(self) -> dict[str, str]:
        """Give the same without what follows from another one."""
        return self.waiting()

    @abstractmethod
    def status_line(self) -> str:
        """Say in a line what the rig is at."""

    @property
    def progress(self) -> tuple[float, float] | None:
        """Give the time done and the whole length of the session [s]; None where none is running."""
        return None

    @abstractmethod
    def advance(self) -> None:
        """Take the rig a step further, once a tick."""

    def deadline_ns(self) -> int:
        """Give the time of the next look at processes and phase [ns]."""
        return self._grid.deadline_ns

    def on_message(self, received: Received) -> None:
        """Take what the nodes say of themselves."""
        message = received.message
        if isinstance(message, NodeHealth):
            self._enter_health(message)
        elif isinstance(message, SessionEvent):
            self.events.append(message)
            self.on_event(message)

    def on_event(self, event: SessionEvent) -> None:
        """Act on what a node said."""

    def on_deadline(self, now_ns: int) -> None:
        """Look after the processes and take the rig a step further."""
        self._grid.advance(now_ns)
        self.overruns = self._grid.overruns
        self.steps += 1
        for node in self.keeper.look(self.say):
            self.health.pop(node, None)
        if not self.failure and self.phase != "ending":
            self.keeper.restart_due(self.say)
        for change in self.watch.look():
            self._tell(change)
        self.advance()
        self.observe(self)

    def make_safe(self) -> None:
        """Take the own nodes down in order; also when the launcher itself failed."""
        self.phase = "over"
        self.keeper.stop()

    def say(self, level: str, text: str, **data: Scalar) -> None:
        """Tell of the rig: as an event, and to whoever looks on."""
        self.news.append(text)
        self.event("node", level, text, answer_to="", **data)

    def _enter_health(self, health: NodeHealth) -> None:
        before = self.health.get(health.src)
        self.health[health.src] = health
        self.watch.enter(health.src)
        restarted = before is not None and health.uptime_s < before.uptime_s and health.src not in self.keeper.nodes
        if restarted and health.src in self.nodes:
            text = f"{health.src} was restarted{self._hints(health.src)}"
            self.say("warning", text, about_node=health.src, pid=health.pid)

    def _tell(self, change: Change) -> None:
        if change.silent:
            # what a silent node said last is no longer so
            for node in change.nodes:
                self.health.pop(node, None)
            at = datetime.fromtimestamp(change.since_ns * 1e-9).astimezone()
            text = f"{change.who} is silent since {at:%H:%M:%S}"
            self.say("warning", text, about_node=change.who, state="silent", silence_s=change.silence_s)
        elif change.first:
            self.say("info", f"{change.who} is heard", about_node=change.who, state="heard")
        else:
            self._tell_return(change)

    def _tell_return(self, change: Change) -> None:
        text = f"{change.who} is heard again after {change.silence_s:.1f} s{self._hints(*change.nodes)}"
        self.say("info", text, about_node=change.who, state="heard", silence_s=change.silence_s)

    def _hints(self, *nodes: str) -> str:
        at = f" --site {self.site}" if self.site else ""
        return "".join("; " + hint.format(at=at) for node, hint in _AGAIN.items() if node in nodes)


class SessionNode(RigNode):
    """Conducts the session of a whole rig, whoever runs its nodes: wait, arm, start, run, stop."""

    def __init__(
        self,
        context: NodeContext,
        keeper: Supervisor,
        duration_s: float,
        *,
        others: Sequence[str] = (),
        site: str = "",
        other_site: str = "",
        wait_s: float | None = None,
        tape: ExternalRecording | None = None,
    ) -> None:
        """Prepare a session of `duration_s` [s].

        Parameters: others, nodes of somebody else that the session needs too; site, the one that this is, empty where
        both are one; other_site, that of the others when they are all of one beyond the link; wait_s, limit for them
        to be ready [s], None for no limit; tape, the recording of somebody else's recorder, None where the own one
        records.
        """
        optional = (tape.recorder,) if tape is not None else ()
        seen = (*optional, *others)
        super().__init__(context, keeper, Watch(context.clock, seen, other_site), seen, site)
        self.duration_s = duration_s
        self.tape = tape
        self.start_id = ""
        self._needed = [node for node in self.nodes if node not in optional]
        self._others = tuple(others)
        self._wait_s = wait_s
        self._muster = ReadinessGate(context.clock, keeper.nodes, others, wait_s)
        self._dialogue: CommandSequence | None = None
        self._running_ns: int | None = None

    @property
    def elapsed_s(self) -> float:
        """Time since the operator's programme started [s]; 0 before that."""
        if self._running_ns is None:
            return 0.0
        return (self.clock.monotonic_ns() - self._running_ns) * 1e-9

    @property
    def progress(self) -> tuple[float, float] | None:
        """Give the time done and the whole length of the session [s]; None before the programme runs."""
        return (min(self.elapsed_s, self.duration_s), self.duration_s) if self.ran else None

    @property
    def ran(self) -> bool:
        """Say whether the operator's programme was started."""
        return self._running_ns is not None

    @property
    def attached(self) -> bool:
        """Say whether every node is somebody else's."""
        return not self.keeper.nodes

    @property
    def waits_for_others(self) -> bool:
        """Say whether the session needs nodes of somebody else."""
        return bool(self._others)

    def waiting(self) -> dict[str, str]:
        """Give for each node that is not ready what it waits for."""
        return self._muster.waiting(self.health)

    def causes(self) -> dict[str, str]:
        """Give the same without inputs that are missing because nodes of somebody else are."""
        return self._muster.causes(self.health)

    def status_line(self) -> str:
        """Say in a line what the session is at."""
        if self.phase == "starting":
            count = f"{len(self.waiting())} of {len(self._needed)} nodes"
            return f"waiting for {count} to be ready ({self._patience()})"
        if self.phase == "running":
            silent = f"; silent: {', '.join(self.watch.silent)}" if self.watch.silent else ""
            return f"running for {self.duration_s:g} s, Ctrl-C stops it cleanly{silent}"
        return {"arming": "arming the devices", "ending": "stopping", "over": "stopped"}[self.phase]

    def _patience(self) -> str:
        """Say how long is waited."""
        own = [] if self.attached else [f"up to {READY_DEADLINE_S:g} s"]
        others = "without a limit" if self._wait_s is None else f"up to {self._wait_s:g} s"
        who = "" if self.attached else f"for {self.watch.site_name} "
        return "; ".join([*own, *([f"{who}{others}, Ctrl-C gives up"] if self._others else [])])

    def on_message(self, received: Received) -> None:
        """Take what the nodes say of themselves."""
        super().on_message(received)
        if self.tape is not None and isinstance(received.message, NodeHealth):
            self.tape.enter_health(received.message)

    def on_event(self, event: SessionEvent) -> None:
        """Take answers to the session's commands, and what becomes of the recording."""
        if self.tape is not None:
            self.tape.enter_event(event)
        if self._dialogue is not None:
            self._dialogue.enter(event)

    def advance(self) -> None:
        """Take the session a step further."""
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

    def _fail(self, text: str) -> None:
        # the first failure is the cause, what follows are its consequences
        self._failure = self._failure or text

    def _advance_start(self) -> None:
        if not self.waiting():
            if self.tape is None or self.tape.settled():
                self._arm()
            return
        limit_s, late = self._muster.overdue(self.health)
        if late:
            reasons = "; ".join(f"{node} {reason}" for node, reason in late.items())
            own = [self.keeper.log_tail_of(node) for node in late if node in self.keeper.nodes]
            self._fail("\n".join([f"the rig was not ready within {limit_s:g} s: {reasons}", *own]))

    def _arm(self) -> None:
        self.phase = "arming"
        # a device that a recording stands in for is not ours to arm, and its operator starts without us
        steps = [step for step in BEGIN if set(step.expected) <= set(self._needed)]
        if self.tape is not None:
            steps = [*self.tape.steps(), *steps]
        self._dialogue = CommandSequence(self.clock, self.publish, steps)
        self._advance_begin()

    def _advance_begin(self) -> None:
        dialogue = self._dialogue
        if any(node not in self.health for node in self._others):
            # somebody was lost while the devices were armed: that is waited for like at the start
            self.phase, self._dialogue = "starting", None
            self._muster.restart()
        elif dialogue is not None and dialogue.advance():
            if dialogue.failure:
                self._fail(dialogue.failure)
            else:
                self._run(dialogue)

    def _run(self, dialogue: CommandSequence) -> None:
        self._running_ns = self.clock.monotonic_ns()
        self.phase = "running"
        self.state = "running"
        self.start_id = dialogue.ids.get("start", "")
        if self.tape is not None:
            self.tape.begun(dialogue.complaints.get(self.tape.recorder))
            if self.tape.fault:
                self.say("warning", f"the session is not recorded: {self.tape.fault}")
        self.event("node", "info", "the session is running", answer_to="", duration_s=self.duration_s)

    def _end(self) -> None:
        """Ask for the end of the operator's programme, where one is running and can still be asked."""
        self.phase = "ending"
        steps: list[Step] = []
        if self.ran and not self.failure:
            steps += [END] if set(END.expected) <= set(self._needed) else []
            steps += self.tape.ending() if self.tape is not None else []
            steps += [LEAVE] if self.attached and TIP in self._needed else []
        self._dialogue = CommandSequence(self.clock, self.publish, steps)
        self._advance_end()

    def _advance_end(self) -> None:
        if self._dialogue is None or self._dialogue.advance():
            ends = "the nodes go on" if self.attached else "the nodes are stopped"
            text = f"the session is over, {ends}"
            self.event("node", "info", text, answer_to="", interrupted=self.interrupted)
            self.context.request_stop()


class SiteNode(RigNode):
    """Keeps the nodes of the slave's site running for a session that the master's conducts; arms and starts nothing."""

    # clock/ping comes from the link itself, past its impairments: it says whether the master's machine is there
    inputs: ClassVar[tuple[str, ...]] = (*RigNode.inputs, "clock/ping")

    def __init__(self, context: NodeContext, keeper: Supervisor, *, link: str, site: str, other_site: str) -> None:
        """Take the face of the link at this site (node@site) and the names of the sites on its sides."""
        super().__init__(context, keeper, Watch(context.clock, (link,), other_site), (), site)
        self._deadline_ns = context.clock.monotonic_ns() + round(READY_DEADLINE_S * 1e9)

    def waiting(self) -> dict[str, str]:
        """Give for each node that is not ready what it waits for; its inputs may be those of the other site."""
        return unmet(self.nodes, self.health, inputs=False)

    def status_line(self) -> str:
        """Say in a line what the site is at."""
        if self.phase in ("ending", "over"):
            return "stopping" if self.phase == "ending" else "stopped"
        site = self.watch.site_name
        if not self.watch.heard:
            silent = "is silent" if self.watch.silent else "has not been heard yet"
            return f"{site} {silent}, the nodes here wait for it; Ctrl-C stops them"
        if self.phase == "starting":
            return f"waiting for {len(self.waiting())} of {len(self.nodes)} nodes to be ready, {site} is heard"
        return f"running, {site} is heard and conducts; Ctrl-C stops the nodes here"

    def on_message(self, received: Received) -> None:
        """Take what the nodes say of themselves, and the sign of life of the link."""
        super().on_message(received)
        if isinstance(received.message, ClockPing):
            self.watch.enter(received.message.src)

    def _hints(self, *nodes: str) -> str:
        # whichever side was away, the tip is here
        return super()._hints(TIP)

    def advance(self) -> None:
        """End when told so or when a node cannot be kept running; see when all are ready."""
        if self.phase in ("starting", "running") and (self.failure or self.interrupted):
            self.phase = "ending"
            self.event("node", "info", "the site is stopped", answer_to="", interrupted=self.interrupted)
            self.context.request_stop()
        elif self.phase == "starting":
            self._advance_start()

    def _advance_start(self) -> None:
        waiting = self.waiting()
        if not waiting:
            self.phase = self.state = "running"
            return
        if self.clock.monotonic_ns() >= self._deadline_ns:
            reasons = "; ".join(f"{node} {reason}" for node, reason in waiting.items())
            last = [self.keeper.log_tail_of(node) for node in waiting]
            self._failure = "\n".join([f"the site was not ready within {READY_DEADLINE_S:g} s: {reasons}", *last])

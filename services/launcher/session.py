"""The launcher as a node of the bus: the state of a rig as it sees it, and the session that it conducts."""

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import ClassVar, Literal

from proto.ends import read_end
from proto.messages import ClockPing, NodeHealth, Scalar, SessionEvent
from proto.nodes import HAND, RECORDER, TIP, name_of
from services.launcher.external_recording import ExternalRecording
from services.launcher.liveness import Change, LivenessMonitor
from services.launcher.processes import StopObserver
from services.launcher.readiness import READY_DEADLINE_S, ReadinessGate, unmet
from services.launcher.recorder_wait import LastMessages, RecorderWait
from services.launcher.supervisor import Supervisor
from services.runtime.bus.bus import Received
from services.runtime.loop.commands import Command, CommandClient
from services.runtime.loop.deadlines import PeriodicDeadline
from services.runtime.loop.node import Node, NodeContext

Phase = Literal["starting", "arming", "running", "ending", "over"]

TICK_S = 0.05
# how long a stopping rig waits for the answer to `stop`; the devices make themselves safe on SIGTERM in any case
_STOP_ANSWER_NS = 2_000_000_000
_EVENTS_KEPT = 8
# a refused command is tried anew for so long
_REFUSAL_RETRY_NS = 5_000_000_000

# the AFM before the haptic device, so that the hand never moves a reference that nothing follows
BEGIN = (
    Command("arm", "afm_node", (TIP,)),
    Command("arm", "haptic_node", (HAND,)),
    Command("start", "*", (HAND,)),
)
END = Command("stop", "*", (HAND,), required=False, deadline_ns=_STOP_ANSWER_NS)
# where the nodes keep running without a session the tip must not stay on the sample without an operator
WITHDRAW_TIP = Command("stop", "afm_node", (TIP,), required=False, deadline_ns=_STOP_ANSWER_NS)
# what the operator has to do when a device was lost and is back; {at} is the option for the site, where there are two
_RECOVERY_HINTS = {
    TIP: "a tip that has retracted stays retracted until `telenano session arm --target afm_node{at}`",
    HAND: "a haptic device that was restarted stays off until `telenano session arm --target haptic_node{at}`, "
    "its programme until `telenano session start{at}`",
}


class RigNode(Node):
    """A rig as its launcher sees it: own processes, which are kept running, and nodes that run elsewhere."""

    inputs: ClassVar[tuple[str, ...]] = ("session/event", "node/health")
    period_s = TICK_S

    def __init__(
        self,
        context: NodeContext,
        supervisor: Supervisor,
        liveness: LivenessMonitor,
        others: Sequence[str],
        site: str = "",
    ) -> None:
        """Prepare to supervise a rig.

        Parameters: supervisor, of own nodes; liveness, of the nodes whose silence is reported; others, nodes that run
        elsewhere; site, the one that this is, empty where both are one.
        """
        super().__init__(context)
        self.supervisor = supervisor
        self.liveness = liveness
        self.site = site
        self.nodes = [*supervisor.nodes, *others]
        self.health: dict[str, NodeHealth] = {}
        self.events: deque[SessionEvent] = deque(maxlen=_EVENTS_KEPT)
        # sentences for the view, which removes what it has shown
        self.reports: deque[str] = deque(maxlen=64)
        self.phase: Phase = "starting"
        self.interrupted = False
        # why recorders have stopped recording, by node
        self.recording_faults: dict[str, str] = {}
        # nodes that have published their last message
        self.ended: set[str] = set()
        self._recorder_states: dict[str, Scalar] = {}
        self.observe: Callable[[RigNode], None] = lambda node: None
        self.state = "starting"
        self._failure = ""
        self._ticks = PeriodicDeadline(self.clock.monotonic_ns(), round(TICK_S * 1e9))

    def launch(self) -> None:
        self.supervisor.launch()

    def interrupt(self) -> None:
        """Request an early end, as Ctrl-C and SIGTERM do."""
        self.interrupted = True

    @property
    def failure(self) -> str:
        """Why the rig cannot go on; empty while it can."""
        return self.supervisor.failure or self._failure

    @abstractmethod
    def waiting(self) -> dict[str, str]:
        """Return for each node that is not ready what it waits for."""

    def causes(self) -> dict[str, str]:
        """Return what `waiting` does, without nodes that wait only for another one."""
        return self.waiting()

    @abstractmethod
    def status_line(self) -> str:
        """Return a line about what the rig is doing."""

    @property
    def progress(self) -> tuple[float, float] | None:
        """Elapsed time and whole length of the session [s]; None while none is running."""
        return None

    @abstractmethod
    def advance(self) -> None:
        """Advance the state machine, once a tick."""

    def deadline_ns(self) -> int:
        return self._ticks.deadline_ns

    def on_message(self, received: Received) -> None:
        message = received.message
        if isinstance(message, NodeHealth):
            self._record_health(message)
        elif isinstance(message, SessionEvent):
            self.events.append(message)
            if message.kind == "recording" and name_of(message.src) == name_of(RECORDER):
                self._note_recording(message)
            if read_end(message.model_dump()) is not None:
                self.ended.add(message.src)
            self.on_event(message)

    def on_event(self, event: SessionEvent) -> None:
        """Process a session/event; nothing by default."""

    def on_deadline(self, now_ns: int) -> None:
        """Supervise the processes, report changes of liveness, and advance the state machine."""
        self._ticks.advance(now_ns)
        self.overruns = self._ticks.overruns
        self.steps += 1
        self.supervisor.handle_hangs(self.report)
        for node in self.supervisor.handle_exits(self.report):
            self.health.pop(node, None)
        if not self.failure and self.phase != "ending":
            self.supervisor.restart_due(self.report)
        for change in self.liveness.check():
            self._report_change(change)
        self.advance()
        self.observe(self)

    def make_safe(self) -> None:
        """Stop own nodes in order; also when the launcher itself failed."""
        self.supervisor.stop(_Ending(self))
        self.phase = "over"

    def report(self, level: str, text: str, **data: Scalar) -> None:
        """Report about the rig: as an event, and as a line for the view."""
        self.reports.append(text)
        self.event("node", level, text, answer_to="", **data)

    def _note_recording(self, event: SessionEvent) -> None:
        """Report what happens to a recording once; a recorder repeats it for readers that come later."""
        state = event.data.get("state", "")
        known = self._recorder_states.get(event.src) == state and state != "draining"
        self._recorder_states[event.src] = state
        if state == "failed":
            self.recording_faults[event.src] = event.text
        if not known and (event.level != "info" or state in ("draining", "disk_ok")):
            self.reports.append(f"{event.src}: {event.text}")

    def _record_health(self, health: NodeHealth) -> None:
        before = self.health.get(health.src)
        self.health[health.src] = health
        if health.state != "stopping":
            self.ended.discard(health.src)
        self.liveness.record(health.src)
        self.supervisor.record_health(health, self.report)
        restarted = before is not None and health.uptime_s < before.uptime_s and health.src not in self.supervisor.nodes
        if restarted and health.src in self.nodes:
            text = f"{health.src} was restarted{self._hints(health.src)}"
            self.report("warning", text, about_node=health.src, pid=health.pid)

    def _report_change(self, change: Change) -> None:
        if change.silent:
            # the last report of a silent node is no longer valid
            for node in change.nodes:
                self.health.pop(node, None)
            at = datetime.fromtimestamp(change.since_ns * 1e-9).astimezone()
            text = f"{change.subject} is silent since {at:%H:%M:%S}"
            self.report("warning", text, about_node=change.subject, state="silent", silence_s=change.silence_s)
        elif change.first:
            self.report("info", f"{change.subject} is alive", about_node=change.subject, state="heard")
        else:
            text = f"{change.subject} is alive again after {change.silence_s:.1f} s{self._hints(*change.nodes)}"
            self.report("info", text, about_node=change.subject, state="heard", silence_s=change.silence_s)

    def _hints(self, *nodes: str) -> str:
        at = f" --site {self.site}" if self.site else ""
        return "".join("; " + hint.format(at=at) for node, hint in _RECOVERY_HINTS.items() if node in nodes)


class _Ending(StopObserver):
    """Receives from the nodes while they are stopped, and reports what takes its time."""

    def __init__(self, rig: RigNode) -> None:
        self._rig = rig
        self._reported_s = 0

    def has_ended(self, node: str) -> bool:
        return node in self._rig.ended

    def wait(self, nodes: Sequence[str], waited_s: float, limit_s: float) -> None:
        rig = self._rig
        for received in rig.context.bus.receive():
            rig.on_message(received)
        if int(waited_s) > self._reported_s:
            senders = [node for node in nodes if name_of(node) != name_of(RECORDER)]
            text = "a reader, the recorder above all, to take the last messages of " if senders else "the end of "
            limit = f"{waited_s:.0f} s, at most {limit_s:.0f} s"
            rig.reports.append(f"waiting for {text}{', '.join(senders or nodes)} ({limit})")
        self._reported_s = int(waited_s)
        rig.observe(rig)


class SessionNode(RigNode):
    """Conducts the session of a whole rig, wherever its nodes run: wait, arm, start, run, stop."""

    def __init__(
        self,
        context: NodeContext,
        supervisor: Supervisor,
        duration_s: float,
        *,
        others: Sequence[str] = (),
        site: str = "",
        other_site: str = "",
        wait_s: float | None = None,
        recording: ExternalRecording | None = None,
    ) -> None:
        """Prepare a session of `duration_s` [s].

        Parameters: others, nodes that run elsewhere and that the session needs too; site, the one that this is, empty
        where both are one; other_site, that of the others when all of them are beyond the link; wait_s, limit for them
        to be ready [s], None for no limit; recording, that of a recorder which runs elsewhere, None where the own one
        records.
        """
        optional = (recording.recorder,) if recording is not None else ()
        seen = (*optional, *others)
        super().__init__(context, supervisor, LivenessMonitor(context.clock, seen, other_site), seen, site)
        self.duration_s = duration_s
        self.recording = recording
        self.start_id = ""
        self._needed = [node for node in self.nodes if node not in optional]
        self._others = tuple(others)
        self._wait_s = wait_s
        self._readiness = ReadinessGate(context.clock, supervisor.nodes, others, wait_s)
        self._commands: CommandClient | None = None
        # a person has asked for the session, and so for all that it arms, by starting this process
        self._wished_ns = context.clock.monotonic_ns()
        # a device in emergency stop from before, and since when it is waited for
        self._latched, self._latched_ns = "", 0
        self._running_ns: int | None = None
        self._wait = RecorderWait(context.clock, RECORDER, self._publishes, self.reports.append)
        far = () if self.attached or not other_site else others
        self._last_messages = LastMessages(context.clock, RECORDER, far, self._publishes, self.reports.append)
        # what is commanded to a recorder that runs elsewhere once it has caught up
        self._last_steps: list[Command] = []

    @property
    def elapsed_s(self) -> float:
        """Time since the operator's programme started [s]; 0 before that."""
        if self._running_ns is None:
            return 0.0
        return (self.clock.monotonic_ns() - self._running_ns) * 1e-9

    @property
    def progress(self) -> tuple[float, float] | None:
        return (min(self.elapsed_s, self.duration_s), self.duration_s) if self.ran else None

    @property
    def ran(self) -> bool:
        """Whether the operator's programme was started."""
        return self._running_ns is not None

    @property
    def not_recorded(self) -> tuple[str, ...]:
        """What the recorder was found to lack at the end, in sentences."""
        return tuple(self._last_messages.missing)

    @property
    def attached(self) -> bool:
        """Whether every node runs elsewhere."""
        return not self.supervisor.nodes

    @property
    def waits_for_others(self) -> bool:
        """Whether the session needs nodes that run elsewhere."""
        return bool(self._others)

    def waiting(self) -> dict[str, str]:
        return self._readiness.waiting(self.health)

    def causes(self) -> dict[str, str]:
        """Return what `waiting` does, without inputs that are missing because nodes that run elsewhere are."""
        return self._readiness.causes(self.health)

    def status_line(self) -> str:
        if self.phase == "starting":
            count = f"{len(self.waiting())} of {len(self._needed)} nodes"
            return f"waiting for {count} to be ready ({self._time_limits()})"
        if self.phase == "arming" and self._latched:
            return self._release_hint()
        if self.phase == "running":
            silent = f"; silent: {', '.join(self.liveness.silent)}" if self.liveness.silent else ""
            return f"running for {self.duration_s:g} s, Ctrl-C stops it cleanly{silent}"
        return {"arming": "arming the devices", "ending": "stopping", "over": "stopped"}[self.phase]

    def _time_limits(self) -> str:
        own = [] if self.attached else [f"up to {READY_DEADLINE_S:g} s"]
        others = "without a limit" if self._wait_s is None else f"up to {self._wait_s:g} s"
        subject = "" if self.attached else f"for {self.liveness.site_name} "
        return "; ".join([*own, *([f"{subject}{others}, Ctrl-C gives up"] if self._others else [])])

    def on_message(self, received: Received) -> None:
        super().on_message(received)
        if isinstance(received.message, NodeHealth):
            self._wait.record(received.message)
            self._last_messages.record(received.message)
            if self.recording is not None:
                self.recording.on_health(received.message)

    def on_event(self, event: SessionEvent) -> None:
        if self.recording is not None:
            self.recording.on_event(event)
        # what a device warns of while it is armed is for the person who starts the session
        if self.phase == "arming" and (event.kind, event.level) == ("fault", "warning"):
            self.reports.append(f"{event.src}: {event.text}")
        if self._commands is not None:
            self._commands.on_event(event)

    def advance(self) -> None:
        if self.phase in ("starting", "arming", "running") and (self.failure or self.interrupted):
            self._end()
        elif self.phase == "starting":
            self._advance_start()
        elif self.phase == "arming":
            self._advance_arming()
        elif self.phase == "running" and self.elapsed_s >= self.duration_s:
            self._end()
        elif self.phase == "ending":
            self._advance_end()

    def _fail(self, text: str) -> None:
        # the first failure is the cause, what follows are its consequences
        self._failure = self._failure or text

    def _advance_start(self) -> None:
        if not self.waiting():
            if self.recording is None or self.recording.settled():
                self._arm()
            return
        limit_s, late = self._readiness.overdue(self.health)
        if late:
            reasons = "; ".join(f"{node} {reason}" for node, reason in late.items())
            own = [self.supervisor.log_tail_of(node) for node in late if node in self.supervisor.nodes]
            self._fail("\n".join([f"the rig was not ready within {limit_s:g} s: {reasons}", *own]))

    def _arm(self) -> None:
        self.phase = "arming"
        # a device that a replay stands in for is not armed from here, and its operator starts by itself
        steps = [step for step in BEGIN if set(step.expected) <= set(self._needed)]
        if self.recording is not None:
            steps = [*self.recording.begin_steps(), *steps]
        self._commands = CommandClient(
            self.clock,
            self.publish,
            steps,
            retry_ns=_REFUSAL_RETRY_NS,
            issued_ns=self._wished_ns,
            # it may have been started by a supervisor, and its nodes by somebody else
            releases_stops=False,
        )
        self._advance_arming()

    def _advance_arming(self) -> None:
        if any(node not in self.health for node in self._others):
            # a node was lost while the devices were armed: it is waited for as at the start
            self.phase, self._commands = "starting", None
            self._readiness.reset()
        elif (commands := self._commands) is not None and not commands.advance():
            self._await_release(commands.latched)
        elif commands is not None:
            if commands.failure:
                self._fail(commands.failure)
            else:
                self._run(commands)

    def _await_release(self, latched: str) -> None:
        """Report once that a device is in emergency stop from before the session; wait for a person to release it."""
        now_ns = self.clock.monotonic_ns()
        if latched and latched != self._latched:
            self._latched, self._latched_ns = latched, now_ns
            self.report("warning", self._release_hint(), about_node=latched, state="latched")
        elif self._latched and self._wait_s is not None and (now_ns - self._latched_ns) * 1e-9 >= self._wait_s:
            self._fail(f"{self._release_hint()}; nobody did within {self._wait_s:g} s")

    def _release_hint(self) -> str:
        at = f" --site {self.site}" if self.site else ""
        arm = f"telenano session arm --target {name_of(self._latched)}{at}"
        return f"{self._latched} is in emergency stop, which a person has to release: `{arm}`"

    def _run(self, commands: CommandClient) -> None:
        self._running_ns = self.clock.monotonic_ns()
        self.phase = "running"
        self.state = "running"
        self.start_id = commands.ids.get("start", "")
        if self.recording is not None:
            self.recording.confirm_start(commands.tolerated_failures.get(self.recording.recorder))
            if self.recording.fault:
                self.report("warning", f"the session is not recorded: {self.recording.fault}")
        self.event("node", "info", "the session is running", answer_to="", duration_s=self.duration_s)

    def _end(self) -> None:
        """Command the end of the operator's programme, where one is running and can still be commanded."""
        was_arming = self.phase == "arming"
        self.phase = "ending"
        withdraw = [WITHDRAW_TIP] if self.attached and TIP in self._needed else []
        # the tip may have been armed when something else failed
        steps: list[Command] = withdraw if was_arming else []
        if self.ran and not self.failure:
            end = [END] if set(END.expected) <= set(self._needed) else []
            split = list(self.recording.end_steps()) if self.recording is not None else []
            # the file of the session is whole before anything else is commanded, but no tip waits for a recorder
            steps = [*end, *split, *withdraw]
            if self.attached and self._wait.behind_s():
                steps, self._last_steps = [*end, *withdraw], split
        self._commands = CommandClient(self.clock, self.publish, steps, retry_ns=_REFUSAL_RETRY_NS)
        self._advance_end()

    def _advance_end(self) -> None:
        if self._commands is not None and not self._commands.advance():
            return
        if self._last_steps and not self._wait.over():
            return
        if self._last_steps:
            self._commands = CommandClient(self.clock, self.publish, self._last_steps, retry_ns=_REFUSAL_RETRY_NS)
            self._last_steps = []
            return
        if self.ran and not self.failure and not self._last_messages.over():
            return
        ends = "the nodes keep running" if self.attached else "the nodes are stopped"
        text = f"the session is over, {ends}"
        self.event("node", "info", text, answer_to="", interrupted=self.interrupted)
        self.context.request_stop()

    def _publishes(self, node: str) -> bool:
        """Return whether a node is at work and sends with stamps of now."""
        health = self.health.get(node)
        return health is not None and health.state != "stopping" and not health.replay

    def interrupt(self) -> None:
        """Request an early end; while the recorder is waited for, the end of the wait."""
        if self.phase == "ending":
            self._wait.skip()
            self._last_messages.skip()
        super().interrupt()


class SiteNode(RigNode):
    """Keeps the nodes of the slave's site running for a session that the master's conducts; arms and starts nothing."""

    # clock/ping comes from the link itself, past its impairments: the heartbeat of the master's machine
    inputs: ClassVar[tuple[str, ...]] = (*RigNode.inputs, "clock/ping")

    def __init__(self, context: NodeContext, supervisor: Supervisor, *, link: str, site: str, other_site: str) -> None:
        """Prepare a site from the endpoint of the link at it (node@site) and the names of both sites."""
        super().__init__(context, supervisor, LivenessMonitor(context.clock, (link,), other_site), (), site)
        self._deadline_ns = context.clock.monotonic_ns() + round(READY_DEADLINE_S * 1e9)

    def waiting(self) -> dict[str, str]:
        """Return for each node that is not ready what it waits for, but for inputs: the other site may send those."""
        return unmet(self.nodes, self.health, inputs=False)

    def status_line(self) -> str:
        if self.phase in ("ending", "over"):
            return "stopping" if self.phase == "ending" else "stopped"
        site = self.liveness.site_name
        if not self.liveness.any_alive:
            silent = "is silent" if self.liveness.silent else "has not reported yet"
            return f"{site} {silent}, the nodes here wait for it; Ctrl-C stops them"
        if self.phase == "starting":
            return f"waiting for {len(self.waiting())} of {len(self.nodes)} nodes to be ready, {site} is alive"
        return f"running, {site} is alive and conducts; Ctrl-C stops the nodes here"

    def on_message(self, received: Received) -> None:
        super().on_message(received)
        if isinstance(received.message, ClockPing):
            self.liveness.record(received.message.src)

    def _hints(self, *nodes: str) -> str:
        # whichever side was lost, the tip is here
        return super()._hints(TIP)

    def advance(self) -> None:
        """End when interrupted or when a node cannot be kept running; change to running when all nodes are ready."""
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
            last = [self.supervisor.log_tail_of(node) for node in waiting]
            self._failure = "\n".join([f"the site was not ready within {READY_DEADLINE_S:g} s: {reasons}", *last])

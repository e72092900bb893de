"""The launcher as a node of the bus: it keeps the processes of a rig running and tracks the state of all its nodes."""

from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import ClassVar, Literal

from telenano.extend.advice import ADVICE
from telenano.launcher.advisers import Advisers
from telenano.launcher.liveness import Change, LivenessMonitor
from telenano.launcher.processes import StopObserver
from telenano.launcher.recorder_wait import has_last
from telenano.launcher.supervisor import Supervisor
from telenano.runtime.bus.places import PlaceNotice
from telenano.runtime.loop.deadlines import PeriodicDeadline
from telenano.runtime.loop.node import Node, NodeContext
from telenano.wire.codec import fields_of
from telenano.wire.ends import read_end
from telenano.wire.messages import NodeHealth, Scalar, SessionEvent
from telenano.wire.nodes import HAND, RECORDER, TIP, name_of
from telenano.wire.received import Received

Phase = Literal["starting", "arming", "running", "ending", "over"]

TICK_S = 0.05
_EVENTS_KEPT = 8
# Delay before removed sockets are reported [ns]; each node checks its paths twice a second, so all have noticed then.
_TOGETHER_NS = 700_000_000
# What stays as it is when a lost device is back. Both devices wait where two sites had lost each other, so the hint
# arms both; to arm one that is armed changes nothing. {at} is the option for the site if there are two.
_RECOVERY_HINTS = {
    TIP: "a tip that has retracted stays retracted until `telenano session arm{at}`",
    HAND: "a haptic device that was restarted stays off until `telenano session arm{at}`, "
    "its force profile until `telenano session start{at}`",
}


class RigNode(Node):
    """A rig as its launcher sees it: own processes, which it keeps running, and nodes that run elsewhere."""

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

        Args:
            context: The context of the node.
            supervisor: Supervises the nodes of this launcher.
            liveness: Monitors the nodes whose silence is reported.
            others: The nodes that run elsewhere.
            site: The site of this launcher; empty if one launcher runs both.
        """
        super().__init__(context)
        self.supervisor = supervisor
        self.liveness = liveness
        self.site = site
        self.nodes = [*supervisor.nodes, *others]
        self.health: dict[str, NodeHealth] = {}
        self.events: deque[SessionEvent] = deque(maxlen=_EVENTS_KEPT)
        # Sentences for the view, which removes those that it has shown.
        self.reports: deque[str] = deque(maxlen=64)
        self.phase: Phase = "starting"
        self.interrupted = False
        # Reasons why recorders have stopped recording, by node.
        self.recording_faults: dict[str, str] = {}
        # Sentences of recorders on files that were removed while they were written.
        self.removed_recordings: list[str] = []
        # Stamp of the last message of each publisher that has ended [ns].
        self.ended: dict[str, int] = {}
        self._recorder_states: dict[str, Scalar] = {}
        self.observe: Callable[[RigNode], None] = lambda node: None
        # Advisers that warn the person who runs the session; None if there are none.
        self.advisers: Advisers | None = None
        self._places = _RemovedPaths()
        self.state = "starting"
        self._failure = ""
        self._ticks = PeriodicDeadline(self.clock.monotonic_ns(), round(TICK_S * 1e9))

    def launch(self) -> None:
        self.supervisor.launch(self.report)

    def interrupt(self) -> None:
        """Request an early end, as Ctrl-C and SIGTERM do."""
        self.interrupted = True

    @property
    def failure(self) -> str:
        """The reason why the rig cannot continue; empty while it can."""
        return self.supervisor.failure or self._failure

    @abstractmethod
    def waiting(self) -> dict[str, str]:
        """Return for each node that is not ready the reason, in words."""

    def causes(self) -> dict[str, str]:
        """Return the reasons of `waiting`, without those that only follow from another missing node."""
        return self.waiting()

    @abstractmethod
    def status_line(self) -> str:
        """Return a line on the present activity of the rig."""

    @property
    def progress(self) -> tuple[float, float] | None:
        """Elapsed time and whole length of the session [s]; None if none has been started."""
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
            if message.kind == "fault" and "path" in message.data:
                self._places.note(message.src, message.data, message.text, self.clock.monotonic_ns())
            if message.kind == "recording" and name_of(message.src) == name_of(RECORDER):
                self._note_recording(message)
            if read_end(fields_of(message)) is not None:
                self.ended[message.src] = message.t_ns
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
        self._look_after_places(now_ns)
        self.advance()
        if self.advisers is not None:
            for warning in self.advisers.look(runs=self.phase == "running"):
                self.report("warning", warning.text, **{**warning.facts, ADVICE: True})
        self.observe(self)

    def on_place(self, notice: PlaceNotice) -> None:
        """Publish the state of a path of the launcher; the view gets one sentence for all nodes."""
        super().on_place(notice)
        facts = {"path": notice.path, "state": notice.state}
        self._places.note(self.context.key, facts, notice.text, self.clock.monotonic_ns())

    def _look_after_places(self, now_ns: int) -> None:
        """Report removed sockets, and end the rig if its own socket is lost, because no command can reach it any more.

        By then the devices have stopped by themselves, and they are made safe as at any end.
        """
        self.reports.extend(self._places.take(now_ns))
        places = self.context.places
        if places is not None and places.is_hopeless and not self._failure:
            text = f"no command reaches this rig any more: {places.obstacle}"
            self._failure = f"{text}; its devices were made safe, and it ends"
            self.report("error", self._failure)

    def make_safe(self) -> None:
        """Stop the own nodes in order, even if the launcher itself failed."""
        self.supervisor.stop(_Ending(self))
        self.phase = "over"

    def report(self, level: str, text: str, **data: Scalar) -> None:
        """Report about the rig, as an event and as a line for the view."""
        self.reports.append(text)
        self.event("node", level, text, answer_to="", **data)

    def _note_recording(self, event: SessionEvent) -> None:
        """Report a change of a recorder's state once; the recorder repeats the event for readers that connect later."""
        state = event.data.get("state", "")
        is_unchanged = self._recorder_states.get(event.src) == state and state != "draining"
        self._recorder_states[event.src] = state
        if state == "removed":
            self.removed_recordings.append(f"{event.src}: {event.text}")
        if state == "failed":
            self.recording_faults[event.src] = event.text
        if not is_unchanged and (event.level != "info" or state in ("draining", "disk_ok", "resumed")):
            self.reports.append(f"{event.src}: {event.text}")

    def _record_health(self, health: NodeHealth) -> None:
        before = self.health.get(health.src)
        self.health[health.src] = health
        if health.state != "stopping":
            self.ended.pop(health.src, None)
        self.liveness.record(health.src)
        self.supervisor.record_health(health, self.report)
        restarted = before is not None and health.uptime_s < before.uptime_s and health.src not in self.supervisor.nodes
        if restarted and health.src in self.nodes:
            text = f"{health.src} was restarted{self._hints(health.src)}"
            self.report("warning", text, about_node=health.src, pid=health.pid)

    def _report_change(self, change: Change) -> None:
        if change.silent:
            # The last report of a silent node is no longer valid.
            for node in change.nodes:
                self.health.pop(node, None)
            at = datetime.fromtimestamp(change.since_ns * 1e-9).astimezone()
            text = f"{change.subject} has been silent since {at:%H:%M:%S}"
            # A relay that is gone silences the other site, which may be as alive as this one.
            alarm = self.supervisor.last_alarm_of_relay() if change.subject not in self.supervisor.nodes else ""
            text += f" ({alarm})" if alarm else ""
            self.report("warning", text, about_node=change.subject, state="silent", silence_s=change.silence_s)
        elif change.first:
            self.report("info", f"{change.subject} is alive", about_node=change.subject, state="heard")
        else:
            text = f"{change.subject} is alive again after {change.silence_s:.1f} s{self._hints(*change.nodes)}"
            self.report("info", text, about_node=change.subject, state="heard", silence_s=change.silence_s)

    def _hints(self, *nodes: str) -> str:
        at = f" --site {self.site}" if self.site else ""
        return "".join("; " + hint.format(at=at) for node, hint in _RECOVERY_HINTS.items() if node in nodes)


class _RemovedPaths:
    """Reports the nodes that have lost their sockets in one sentence, because a removed folder affects them all."""

    def __init__(self) -> None:
        self._nodes: dict[str, str] = {}
        self._lost: list[str] = []
        self._due_ns = 0

    def note(self, node: str, facts: Mapping[str, Scalar], text: str, now_ns: int) -> None:
        """Record the report of a node on one of its paths: `facts` with `path` and `state`, and its text."""
        if facts.get("state") == "lost":
            self._lost.append(f"{node}: {text}")
        elif facts.get("state") == "made_again":
            self._due_ns = self._due_ns if self._nodes else now_ns + _TOGETHER_NS
            self._nodes[node] = str(facts["path"])

    def take(self, now_ns: int) -> list[str]:
        """Return the sentences that are due, and clear them."""
        told, self._lost = self._lost, []
        if self._nodes and now_ns >= self._due_ns:
            folder = Path(next(iter(self._nodes.values()))).parent
            text = f"files of {', '.join(sorted(self._nodes))} in {folder} were removed or replaced while the rig ran"
            told.append(f"warning: {text}; it was made again, and commands reach the rig as before")
            self._nodes = {}
        return told


class _Ending(StopObserver):
    """Receives messages of the nodes while they are stopped, and reports once a second which are waited for."""

    def __init__(self, rig: RigNode) -> None:
        self._rig = rig
        self._reported_s = 0

    def has_ended(self, node: str) -> bool:
        return node in self._rig.ended

    def has_delivered(self, node: str, gone: Collection[str]) -> bool:
        ends_ns = {src: at_ns for src, at_ns in self._rig.ended.items() if name_of(src) == name_of(node)}
        recorders = [one for src, one in self._rig.health.items() if name_of(src) == name_of(RECORDER)]
        return node in ends_ns and all(has_last(one, ends_ns) for one in recorders if one.src not in gone)

    def wait(self, nodes: Sequence[str], waited_s: float, limit_s: float) -> None:
        rig = self._rig
        for received in rig.context.bus.receive():
            rig.on_message(received)
        if int(waited_s) > self._reported_s:
            others = [node for node in nodes if name_of(node) != name_of(RECORDER)]
            behind = [node for node in others if not self.has_delivered(node, ())]
            text = "waiting for the end of {}"
            if behind:
                text = "saving the last messages of {} (the recorder is behind)"
            names = ", ".join(behind or others or nodes)
            rig.reports.append(f"{text.format(names)}: {waited_s:.0f} s, at most {limit_s:.0f} s")
        self._reported_s = int(waited_s)
        rig.observe(rig)

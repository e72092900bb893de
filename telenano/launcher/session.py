"""The node of the launcher that conducts a session: wait for the nodes, arm the devices, start, run, stop."""

from collections.abc import Callable, Sequence
from typing import ClassVar

from telenano.launcher.external_recording import ExternalRecording
from telenano.launcher.liveness import LivenessMonitor
from telenano.launcher.readiness import READY_DEADLINE_S, ReadinessGate
from telenano.launcher.recorder_wait import LastMessages, RecorderWait
from telenano.launcher.rig_node import RigNode
from telenano.launcher.supervisor import Supervisor
from telenano.runtime.loop.arming import ARM_HAND, ARM_TIP, PLACE_TIP, START, for_stand_in
from telenano.runtime.loop.commands import Command, CommandClient
from telenano.runtime.loop.node import NodeContext
from telenano.runtime.wiring.link_transports import LineCheck
from telenano.wire.messages import NodeHealth, Scalar, SessionEvent
from telenano.wire.nodes import HAND, RECORDER, TIP, name_of
from telenano.wire.received import Received

# Longest wait for the answer to `stop` at the end [ns]; the devices make themselves safe on SIGTERM in any case.
_STOP_ANSWER_NS = 2_000_000_000
# Time for which a refused command is repeated [ns].
_REFUSAL_RETRY_NS = 5_000_000_000

END = Command("stop", "*", (HAND,), required=False, deadline_ns=_STOP_ANSWER_NS)
# Sent if the nodes keep running after the session: the tip must not stay on the sample without an operator.
WITHDRAW_TIP = Command(
    "stop",
    "afm_node",
    (TIP,),
    required=False,
    deadline_ns=_STOP_ANSWER_NS,
    parameters={"because": "the session has ended"},
)


class SessionNode(RigNode):
    """Conducts the session of a whole rig, wherever its nodes run: wait, arm, start, run, stop."""

    inputs: ClassVar[tuple[str, ...]] = (*RigNode.inputs, "link/network")

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
        far: ExternalRecording | None = None,
        on_far: Callable[[Sequence[str]], None] = lambda files: None,
        line_check: Callable[[Callable[[], int]], LineCheck | None] = lambda monotonic_ns: None,
    ) -> None:
        """Prepare a session of `duration_s` [s].

        Args:
            context: The context of the node.
            supervisor: Supervises the nodes of this launcher.
            duration_s: The length of the session [s].
            others: The nodes that run elsewhere and that the session needs too.
            site: The site of this launcher; empty if one launcher runs both.
            other_site: The site of the others if all of them are beyond the link; else empty.
            wait_s: The longest wait for the others to be ready [s]; None for no limit.
            recording: The recording of a recorder that runs elsewhere; None if the own recorder records.
            far: The additional recording by the other site's recorder; None if there is none.
            on_far: Called with the files of `far` after the start and at the end of the session.
            line_check: Returns the check of the line between the sites for a clock [ns]; None if there is none.
        """
        optional = (recording.recorder,) if recording is not None else ()
        seen = (*optional, *others)
        super().__init__(context, supervisor, LivenessMonitor(context.clock, seen, other_site), seen, site)
        self.duration_s = duration_s
        self.recording = recording
        self.far = far
        self._on_far = on_far
        self._is_far_ended = False
        self.start_id = ""
        self._needed = [node for node in self.nodes if node not in optional]
        self.others = tuple(others)
        self._wait_s = wait_s
        self._readiness = ReadinessGate(context.clock, supervisor.nodes, others, wait_s)
        self._commands: CommandClient | None = None
        # Time of the order [ns]: by starting this process, a person has ordered the session and all that it arms.
        self._wished_ns = context.clock.monotonic_ns()
        self._is_ordered = False
        # Device in an earlier emergency stop that a person has to release, and the start of this wait [ns].
        self._latched, self._latched_ns = "", 0
        self._running_ns: int | None = None
        self._wait = RecorderWait(context.clock, RECORDER, self._publishes, self.reports.append)
        self._line = line_check(context.clock.monotonic_ns)
        beyond = () if self.attached or not other_site else others
        self._last_messages = LastMessages(context.clock, RECORDER, beyond, self._publishes, self.reports.append)
        # Commands for a remote recorder, sent once it has caught up.
        self._last_steps: list[Command] = []

    @property
    def elapsed_s(self) -> float:
        """Time since the start of the operator's force profile [s]; 0 before that."""
        if self._running_ns is None:
            return 0.0
        return (self.clock.monotonic_ns() - self._running_ns) * 1e-9

    @property
    def progress(self) -> tuple[float, float] | None:
        return (min(self.elapsed_s, self.duration_s), self.duration_s) if self.ran else None

    @property
    def ran(self) -> bool:
        """Whether the operator's force profile was started."""
        return self._running_ns is not None

    @property
    def _external(self) -> tuple[ExternalRecording, ...]:
        return tuple(recording for recording in (self.recording, self.far) if recording is not None)

    @property
    def not_recorded(self) -> tuple[str, ...]:
        """Sentences on messages that the recorder lacked at the end."""
        return tuple(self._last_messages.missing)

    @property
    def attached(self) -> bool:
        """Whether every node runs elsewhere."""
        return not self.supervisor.nodes

    def waiting(self) -> dict[str, str]:
        return self._readiness.waiting(self.health)

    def causes(self) -> dict[str, str]:
        """Return the reasons of `waiting`, without inputs that are missing because a node elsewhere is."""
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
        return {"arming": "arming the devices and placing the tip", "ending": "stopping", "over": "stopped"}[self.phase]

    def _time_limits(self) -> str:
        own = [] if self.attached else [f"up to {READY_DEADLINE_S:g} s"]
        others = "without a limit" if self._wait_s is None else f"up to {self._wait_s:g} s"
        subject = "" if self.attached else f"for {self.liveness.site_name} "
        return "; ".join([*own, *([f"{subject}{others}, Ctrl-C gives up"] if self.others else [])])

    def on_message(self, received: Received) -> None:
        super().on_message(received)
        if self._line is not None:
            self._line.record(received.message)
        if isinstance(received.message, NodeHealth):
            self._wait.record(received.message)
            self._last_messages.record(received.message)
            for recording in self._external:
                recording.on_health(received.message)
        if self.phase == "arming":
            # A person waits, so each command is sent at the answer to the one before, and not at the next tick.
            self.advance()

    def on_event(self, event: SessionEvent) -> None:
        for recording in self._external:
            recording.on_event(event)
        # Show the warnings of devices during arming to the person who starts the session.
        if self.phase == "arming" and (event.kind, event.level) == ("fault", "warning"):
            self.reports.append(f"{event.src}: {event.text}")
        if self._commands is not None:
            self._commands.on_event(event)
        # The start of a session orders the placing of the tip once; the acknowledgement uses that order up.
        is_answer = (event.src, event.kind, event.data.get("command")) == (TIP, "ack", "arm")
        self._is_ordered |= is_answer and self.phase == "arming"

    def report(self, level: str, text: str, **data: Scalar) -> None:
        super().report(level, text, **data)
        # A launcher does not receive its own messages.
        if self._commands is not None and "exit_code" in data:
            self._commands.note_end(str(data.get("about_node", "")), text)

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
        # The first failure is the cause; later ones are its consequences.
        self._failure = self._failure or text

    def _advance_start(self) -> None:
        if self._line is not None and (refusal := self._line.refusal()):
            self._fail(refusal)
        elif not self.waiting():
            if all([recording.settled() for recording in self._external]) and self._line_permits():
                self._arm()
            return
        limit_s, late = self._readiness.overdue(self.health)
        if late:
            reasons = "; ".join(f"{node} {reason}" for node, reason in late.items())
            own = [self.supervisor.log_tail_of(node) for node in late if node in self.supervisor.nodes]
            self._fail("\n".join([f"the rig was not ready within {limit_s:g} s: {reasons}", *own]))

    def _line_permits(self) -> bool:
        """Return whether the line between the sites is measured or needs no check; report advice on a slow one."""
        if self._line is None:
            return True
        if not self._line.settled():
            return False
        for text in self._line.advice():
            self.report("warning", text)
        return True

    def _arm(self) -> None:
        self.phase = "arming"
        steps = self._first_steps()
        steps = [*(step for recording in self._external for step in recording.begin_steps()), *steps]
        self._commands = CommandClient(
            self.clock,
            self.publish,
            steps,
            retry_ns=_REFUSAL_RETRY_NS,
            issued_ns=self._wished_ns,
            # A start is no person's order to release a stop: a supervisor may have started this launcher, and another
            # user its nodes.
            releases_stops=False,
            token=self.context.machine.token,
        )
        self._advance_arming()

    def _first_steps(self) -> list[Command]:
        """Return the commands that begin the session; a stand-in for the hand gets the commands of the hand."""
        of_hand = [ARM_HAND, START] if HAND in self._needed else [for_stand_in(step) for step in (ARM_HAND, START)]
        arm_tip = ARM_TIP if self._is_ordered else PLACE_TIP
        return [of_hand[0], *([arm_tip] if TIP in self._needed else []), of_hand[1]]

    def _advance_arming(self) -> None:
        if any(node not in self.health for node in self.others):
            # A node was lost during arming: wait for it as at the start.
            self.phase, self._commands = "starting", None
            self._readiness.reset()
            if self._is_ordered:
                at = f" --site {self.site}" if self.site else ""
                text = "a node was lost after the tip had been sent to its place: the tip stays where it is"
                self.report("warning", f"{text}; `telenano session arm --return{at}` takes it back", about_node=TIP)
        elif (commands := self._commands) is not None and not commands.advance():
            self._await_release(commands.latched)
        elif commands is not None:
            if commands.failure:
                self._fail(commands.failure)
            else:
                self._run(commands)

    def _await_release(self, latched: str) -> None:
        """Report once that a device is in emergency stop from before the session, and wait until a person releases it.

        After `wait_s`, if given, the session fails.
        """
        now_ns = self.clock.monotonic_ns()
        if latched and latched != self._latched:
            self._latched, self._latched_ns = latched, now_ns
            self.report("warning", self._release_hint(), about_node=latched, state="latched")
        elif self._latched and self._wait_s is not None and (now_ns - self._latched_ns) * 1e-9 >= self._wait_s:
            self._fail(f"{self._release_hint()}; it was not done within {self._wait_s:g} s")

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
        if self.far is not None:
            self.far.confirm_start(commands.tolerated_failures.get(self.far.recorder))
            if self.far.fault:
                self.report("warning", f"the fast messages of the slave's site are not recorded: {self.far.fault}")
            self._on_far(self.far.files)
        self.event("node", "info", "the session is running", answer_to="", duration_s=self.duration_s)

    def _end(self) -> None:
        """Begin to end the session: stop the force profile if it runs, complete its files, withdraw a tip if needed."""
        was_arming = self.phase == "arming"
        self.phase = "ending"
        withdraw = [WITHDRAW_TIP] if self.attached and TIP in self._needed else []
        # The tip may already have been armed when another command failed.
        steps: list[Command] = withdraw if was_arming else []
        if self.ran and not self.failure:
            end = [END] if set(END.expected) <= set(self._needed) else []
            split = list(self.recording.end_steps()) if self.recording is not None else []
            # Complete the session's file before the tip is withdrawn; but the tip does not wait for a late recorder.
            steps = [*end, *split, *withdraw]
            if self.attached and self._wait.behind_s():
                steps, self._last_steps = [*end, *withdraw], split
        self._commands = self._client(steps)
        self._advance_end()

    def _advance_end(self) -> None:
        if self._commands is not None and not self._commands.advance():
            return
        if self._last_steps and not self._wait.over():
            return
        if self._last_steps:
            self._commands = self._client(self._last_steps)
            self._last_steps = []
            return
        if self.ran and not self.failure and not self._last_messages.over():
            return
        if self.ran and self.far is not None and not self._is_far_ended:
            # Complete the session's file of the other site: it has all messages sent until now.
            self._is_far_ended = True
            files = list(self.far.files)
            self._commands = self._client(self.far.end_steps())
            self._on_far(files)
            return
        ends = "the nodes keep running" if self.attached else "the nodes are stopped"
        text = f"the session is over, {ends}"
        self.event("node", "info", text, answer_to="", interrupted=self.interrupted)
        self.context.request_stop()

    def _client(self, steps: Sequence[Command]) -> CommandClient:
        token = self.context.machine.token
        return CommandClient(self.clock, self.publish, steps, retry_ns=_REFUSAL_RETRY_NS, token=token)

    def _publishes(self, node: str) -> bool:
        """Return whether a node has reported, is not stopping, and is not a replay, whose stamps are old."""
        health = self.health.get(node)
        return health is not None and health.state != "stopping" and not health.replay

    def interrupt(self) -> None:
        """Request an early end; while the recorder is waited for, end that wait."""
        if self.phase == "ending":
            self._wait.skip()
            self._last_messages.skip()
        super().interrupt()

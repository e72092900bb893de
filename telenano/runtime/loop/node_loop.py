"""The loop that all nodes run in."""

import signal
import socket
from collections.abc import Callable
from types import FrameType
from typing import cast

from telenano.runtime.loop.commands import STALL_NS, CommandHandler, stop_of
from telenano.runtime.loop.deferred import Deferred, Task
from telenano.runtime.loop.housekeeping import Housekeeping, named
from telenano.runtime.loop.journal import DEADLINE, DEFERRED, InputJournal
from telenano.runtime.loop.node import HEALTH_PERIOD_NS, Node, NodeBus
from telenano.runtime.loop.realtime import RealtimeStatus
from telenano.settings.plugins import fault_of_package
from telenano.timing.clock import NEVER_NS
from telenano.timing.freshness import LOOP_DEADLINE_NS
from telenano.wire import TOPICS, encode
from telenano.wire.codec import WireError, accept
from telenano.wire.errors import described
from telenano.wire.messages import NodeHealth, SessionControl
from telenano.wire.received import Received
from telenano.wire.sequence import Arrival

# Interval of the reports of a starting node: short, because a rig waits until every node has reported that it receives
# its inputs.
STARTING_PERIOD_NS = 100_000_000
# Longest time for which a node reports at this interval.
_STARTING_NS = 3_000_000_000
# Bound to a name, because it is used for every message and the lookup of an enumeration member takes longer.
_AFTER_GAP = Arrival.AFTER_GAP


class NodeLoop:
    """The loop of a node: it handles messages and deadlines as they come, and reports health twice a second."""

    def __init__(
        self,
        node: Node,
        bus: NodeBus,
        realtime: RealtimeStatus,
        *,
        starting_period_ns: int = HEALTH_PERIOD_NS,
        note_alive: Callable[[], None] = lambda: None,
    ) -> None:
        """Make a loop.

        Args:
            node: The node.
            bus: The bus of the node.
            realtime: The scheduling that the process was granted, for the reports.
            starting_period_ns: Interval of the reports while the node starts [ns].
            note_alive: Called with each report of health.
        """
        self.node = node
        self._starting_period_ns = starting_period_ns
        self._bus = bus
        self._clock = node.context.clock
        self._commands = CommandHandler(
            node.context.key,
            node.commands,
            node.on_control,
            node.event,
            is_latched=lambda: node.is_latched,
            kept=node.context.kept_stop,
            obstacle=lambda: "" if self._places is None else self._places.obstacle,
            token=node.context.machine.token,
        )
        self._places = node.context.places
        self._stop_signalled = False
        # The file of a kept stop is checked at the start, after each stall of the process, and twice a second: its
        # sender may have ended before it could send the stop.
        self._may_be_kept = True
        self._housekeeping = Housekeeping(node, bus, realtime, note_alive, self._stop_now)
        self._attempt, self._lateness = self._housekeeping.attempt, self._housekeeping.lateness
        self._started_ns = self._awake_ns = self._health_ns = self._clock.monotonic_ns()
        self._deferred = node.context.deferred
        self._journal = InputJournal(node, bus.sequence_numbers) if node.journalled else None
        self._own_stops = 0

    def run(self) -> None:
        """Run until a stop is requested; then make the node safe, also after an error."""
        context = self.node.context
        try:
            while not context.stop_requested:
                self.turn()
        # Code of a package may raise SystemExit.
        except (Exception, SystemExit) as error:
            self.report_failure(error)
            raise
        finally:
            self.end()

    def report_failure(self, error: BaseException) -> None:
        """Publish the error with which a turn has failed."""
        text = fault_of_package(error) or f"this node failed: {described(error)}"
        self.node.event("fault", "error", " ".join(text.split()))

    def end(self) -> None:
        """Make the node safe, and publish its last report and its last message."""
        # Making the device safe is no turn, so the node uses the running clock and not that of the journal.
        self.node.clock = self._clock
        try:
            self.node.make_safe()
        finally:
            # The reports are sent even if the device fails to become safe.
            self.node.state = "stopping"
            self.publish_health()
            self.node.publish_end(self._bus)

    @property
    def health_due_ns(self) -> int:
        """Monotonic time of the next report, or of the next deferred task that this loop runs itself [ns]."""
        return min(self._health_ns, self._deferred.due_ns)

    #  wait               until a message, the deadline of the node, a report or a deferred task is due
    #   |
    #  _take_kept_stop    an emergency stop kept in a file comes before all waiting messages
    #  _take              each message: admits -> on_message -> CommandHandler -> journal
    #  _housekeeping      connections to other machines that were made, lost or refused
    #  _act_on_deadline   if the deadline has come: on_deadline -> journal
    #  note_event         tells the deferred tasks whether other processes work on the tick now
    #  _defer_report      twice a second: the housekeeping and the batch of the journal become deferred tasks
    #  _run_deferred      the tasks that fit before the next message
    #  _end_batch         if the journal is full
    #   |
    #  the next turn
    def turn(self) -> None:
        """Wait for the next message or deadline and act on it."""
        self._bus.wait(min(self.node.deadline_ns(), self._health_ns, self._deferred.due_ns))
        self.turn_now()

    def turn_now(self) -> None:
        """Act on what has come, without a wait: the owner of several loops waits for all of them."""
        woken = self._note_awake()
        if self._may_be_kept:
            self._take_kept_stop()
        taken = self._take(woken)
        self._housekeeping.process_events()
        # A message may have moved the deadline.
        deadline = self.node.deadline_ns()
        now = self._clock.monotonic_ns()
        event = taken[-1].topic if taken else None
        if deadline <= now:
            self._lateness.record((now - deadline) * 1e-9)
            self._act_on_deadline(now)
            event = ""
        if event is not None and self.node.idle_after is not None:
            self._deferred.note_event(woken, self._clock.monotonic_ns(), is_last=event == self.node.idle_after)
        if now >= self._health_ns:
            self._defer_report(now)
        if self._deferred.due_ns < NEVER_NS:
            self._run_deferred()
        if self._journal is not None and self._journal.full:
            self._end_batch()

    def _take(self, woken_ns: int) -> list[Received]:
        """Act on the messages that have arrived, and return them."""
        taken = list(self._bus.receive())
        if taken and self._journal is not None:
            taken = self._retimed(taken, woken_ns)
        for received in taken:
            self._dispatch(received)
        return taken

    def note_stop_signal(self) -> None:
        """Make the next turn obey an emergency stop; called within the handler of STOP_SIGNAL."""
        self._stop_signalled = self._may_be_kept = True

    def _take_kept_stop(self) -> None:
        """Obey an emergency stop that came by the signal or is kept in the file and new, before waiting messages."""
        self._may_be_kept = False
        if self._stop_signalled:
            self._stop_signalled = False
            self._stop_now("an emergency stop came by a signal, as where no socket of this device is reached")
        latch, now_ns = self._commands.latch, self._clock.now_ns()
        payload = self._attempt("the look for a kept emergency stop", latch.kept, None)
        if payload is None:
            return
        try:
            control = accept("session/control", payload)
        except WireError:
            control = None
        if not isinstance(control, SessionControl) or control.command != "estop":
            # An unreadable file also means that a person has stopped the node.
            control = stop_of(self.node.kept_stop_for, now_ns, self.node.context.machine.token)
            payload = encode(control)
        if control.id != latch.newest_id and not self.node.has_taken_over(control.id):
            self._dispatch(Received("session/control", control, payload, now_ns, Arrival.NEXT))
            device = "this device" if self.node.kept_stop_for == self.node.context.key else self.node.kept_stop_for
            self.node.event("mode", "warning", f"an emergency stop that was kept for {device} is in force")

    def _stop_now(self, text: str) -> None:
        """Obey an emergency stop that was not sent as a message; `text` reports its cause."""
        now_ns = self._clock.now_ns()
        control = stop_of(self.node.context.key, now_ns, self.node.context.machine.token)
        self._dispatch(Received("session/control", control, encode(control), now_ns, Arrival.NEXT))
        self.node.event("mode", "warning", text)

    def _act_on_deadline(self, now_ns: int) -> None:
        self._take_turn(now_ns, lambda: self.node.on_deadline(now_ns), DEADLINE)
        if self.node.own_stops != self._own_stops:
            self._own_stops = self.node.own_stops
            self._commands.note_own_stop(self.node.clock.now_ns())

    def _take_turn(self, now_ns: int, act: Task, kind: int) -> None:
        """Take a turn without a message, at a monotonic time [ns], and record it as `kind` in the journal."""
        journal = self._journal
        if journal is not None:
            journal.clock.time_ns = now_ns + journal.clock.epoch_offset_ns
        act()
        if journal is not None:
            journal.record_turn(kind)

    def _defer_report(self, now_ns: int) -> None:
        """Defer the tasks of a report: the housekeeping, and the batch of the journal."""
        # A running node that receives its inputs is in a session, where each report costs time of the loop.
        is_waited_for = self.node.state != "running" or not self._housekeeping.receives_all
        starting = is_waited_for and now_ns - self._started_ns < _STARTING_NS
        self._health_ns = now_ns + (self._starting_period_ns if starting else HEALTH_PERIOD_NS)
        self._may_be_kept = True
        for task in self._housekeeping.tasks:
            self._deferred.add(task)
        if self._journal is not None:
            self._deferred.add(self._complete_batch)

    def _run_deferred(self) -> None:
        """Run the deferred tasks that are due."""
        while (now_ns := self._clock.monotonic_ns()) >= self._deferred.due_ns:
            if (task := self._deferred.take(now_ns, self.node.deadline_ns())) is not None:
                self.run_task(task)

    def run_task(self, task: Deferred) -> None:
        """Run a deferred task of this node, recorded as a turn if it is one; any other one is housekeeping."""
        begin_ns = self._clock.monotonic_ns()
        if task.is_turn:
            self._take_turn(begin_ns, task.run, DEFERRED)
        else:
            self._attempt(named(task.run), task.run, None)
        end_ns = self._clock.monotonic_ns()
        if self.node.idle_after is not None:
            self._deferred.note_run(task.run, begin_ns, end_ns, met=self._bus.has_arrived())

    def _complete_batch(self) -> None:
        """End the batch of the journal once no turn of the node waits: a re-run begins without waiting tasks."""
        if self._journal is None:
            return
        if self._deferred.has_turns:
            self._deferred.add(self._complete_batch)
        else:
            self._deferred.forget_unneeded()
            self._journal.complete()
            self._deferred.add(self._publish_journal)

    def _publish_journal(self) -> None:
        """Send one message of the journal; the further ones of a large state are deferred to later idle gaps."""
        if self._journal is not None and self._journal.publish():
            self._deferred.add(self._publish_journal)

    def _end_batch(self) -> None:
        """Run all waiting turns, then end the batch of the journal and send it at once."""
        if self._journal is None:
            return
        self._deferred.forget_unneeded()
        while (task := self._deferred.take_turn()) is not None:
            self._take_turn(self._clock.monotonic_ns(), task, DEFERRED)
        self._journal.end()

    def publish_health(self) -> None:
        """Send node/health and the journal, and start a new interval."""
        for task in (self._housekeeping.measure_health, self._housekeeping.send_health, self._end_journal):
            self._attempt(named(task), task, None)

    def _end_journal(self) -> None:
        if self._journal is not None:
            self._journal.end()

    def _note_awake(self) -> int:
        """Return the monotonic time [ns]; record a stall if the last call is longer ago than a command is valid."""
        now = self._clock.monotonic_ns()
        if now - self._awake_ns > STALL_NS:
            self._commands.note_stall(self._clock.now_ns(), now - self._awake_ns)
        self._may_be_kept |= now - self._awake_ns > LOOP_DEADLINE_NS
        self._awake_ns = now
        return now

    def _dispatch(self, received: Received) -> None:
        if received.arrival is _AFTER_GAP and TOPICS[received.topic].delivery == "lossless":
            self._report_gap(received)
        if not self.node.admits(received):
            return
        journal = self._journal
        if journal is not None:
            journal.clock.time_ns = received.received_ns
        self.node.on_message(received)
        executed = False
        # `isinstance` is avoided, because the message classes implement it in slow Python code.
        kind = type(received.message)
        if kind is SessionControl:
            self._note_awake()
            executed = self._commands.handle(cast(SessionControl, received.message), self.node.clock.now_ns())
        # Usually only `admits` uses the health of others, and the journal has the admitted messages, so node/health is
        # left out.
        if journal is not None and (kind is not NodeHealth or self.node.acts_on_health):
            journal.record_message(received, executed=executed)

    def _retimed(self, taken: list[Received], woken_ns: int) -> list[Received]:
        """Return the messages, stamped as received now if the process stalled since it woke up, for true ages."""
        now_ns = self._clock.monotonic_ns()
        if now_ns - woken_ns <= LOOP_DEADLINE_NS:
            return taken
        return [received._replace(received_ns=now_ns + self._clock.epoch_offset_ns) for received in taken]

    def _report_gap(self, received: Received) -> None:
        source = received.message.src
        text = f"{received.topic}: messages from {source} were lost before number {received.message.seq}"
        self.node.event("fault", "warning", text, topic=received.topic, source=source, seq=received.message.seq)


def install_stop_signals(stop: Callable[[], None]) -> int:
    """Call `stop` on SIGTERM and SIGINT; return a descriptor that becomes readable at a signal, to end a wait."""
    reader, writer = socket.socketpair()
    for end in (reader, writer):
        end.setblocking(False)
    signal.set_wakeup_fd(writer.detach(), warn_on_full_buffer=False)

    def handle(number: int, frame: FrameType | None) -> None:
        stop()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, handle)
    return reader.detach()

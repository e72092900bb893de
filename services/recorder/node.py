"""The recorder as a node, which subscribes to every node at that node's own endpoint and records all messages."""

import time
from collections.abc import Callable, Iterator, Sequence
from typing import ClassVar

import zmq

from services.recorder.intake import Intake
from telenano.console.listener import Listener
from telenano.recording.disk_watch import DiskWatch
from telenano.recording.recorder_config import RecorderConfig
from telenano.runtime.bus.bus import NetworkEvents, ZmqBus
from telenano.runtime.bus.publisher import Publisher
from telenano.runtime.loop.deadlines import PeriodicDeadline
from telenano.runtime.loop.node import Node, NodeContext
from telenano.timing.clock import Clock
from telenano.wire.errors import RefusedError
from telenano.wire.messages import MAX_TEXT, SessionControl
from telenano.wire.received import Received

# Longest time to read the messages that still wait in the sockets at the end; on a busy machine these are seconds of
# messages. It is within the grace period of the supervisor.
_DRAIN_TIMEOUT_NS = 20_000_000_000
# Interval of reports on that, and of repeated reports on a fault of the recording.
_REPORT_PERIOD_NS = 1_000_000_000
# Largest count on the wire; a peer may have sent arbitrary numbers.
_GREATEST_COUNT = 2**63 - 1
# Reading ends after this many passes in a row without a backlog, because nodes of another site may continue to send.
_CALM_PASSES = 30
# Longest wait of a pass for messages.
_PASS_NS = 5_000_000
# Number of messages in a pass that counts as a backlog.
_BACKLOG = 256
# Time over which the rate of recording is measured.
_RATE_PERIOD_NS = 1_000_000_000
# Interval of reading: waking up for every message costs more than writing it, and disturbs the loop.
_PERIOD_NS = 1_000_000
ACTIONS = ("record.split", "record.status")


class RecorderBus(ZmqBus):
    """A bus with a separate connection to each publisher, so that the site of reception of a message is known."""

    def __init__(
        self,
        publisher: Publisher,
        listeners: Sequence[Listener],
        intake: Intake,
        clock: Clock,
        wake_descriptor: int,
        network: NetworkEvents | None = None,
    ) -> None:
        super().__init__(publisher, [listener.subscriber for listener in listeners], clock, wake_descriptor, network)
        self._intake = intake
        self._listeners: dict[object, Listener] = {listener.subscriber.socket: listener for listener in listeners}
        # One poll of a dozen sockets takes 6 us instead of 19 us for asking each, and is needed for every few messages.
        self._poller = zmq.Poller()
        for descriptor in (*self._listeners, wake_descriptor, *self._network_descriptors):
            self._poller.register(descriptor, zmq.POLLIN)
        self._ready: list[tuple[object, int]] = []
        self._taken_ns = 0

    def receive(self) -> Iterator[Received]:
        """Record the messages that have arrived; yield only commands, which the node answers."""
        ready, self._ready = self._ready or self._poller.poll(0), []
        for socket, _ in ready:
            if (listener := self._listeners.get(socket)) is None:
                continue
            for frames, received_ns in listener.subscriber.receive_raw(signalled=True):
                received = self._intake.record(listener, frames, received_ns)
                if received is not None:
                    yield received

    def wait(self, deadline_ns: int) -> None:
        """Wait until a message arrives or the monotonic clock reaches `deadline_ns`.

        Messages within `_PERIOD_NS` are received together; their reception times are late by at most this period.
        """
        now_ns = self._clock.monotonic_ns()
        if self._taken_ns <= now_ns < self._taken_ns + _PERIOD_NS:
            time.sleep((self._taken_ns + _PERIOD_NS - now_ns) * 1e-9)
            now_ns = self._clock.monotonic_ns()
        self._taken_ns = now_ns
        remaining_ns = max(0, deadline_ns - now_ns)
        # Round up, because waking a little early would only require another wait.
        self._ready = self._poller.poll(0 if self._events_pending else -(-remaining_ns // 1_000_000))
        if self._network_descriptors:
            self._events_pending |= any(socket in self._network_descriptors for socket, _ in self._ready)


class RecorderNode(Node):
    """Node that flushes the recording at periodic deadlines and reports its state."""

    inputs: ClassVar[tuple[str, ...]] = ("session/control",)
    commands: ClassVar[tuple[str, ...]] = ("mark",)
    named_commands: ClassVar[tuple[str, ...]] = ("set",)

    def __init__(
        self,
        context: NodeContext,
        config: RecorderConfig,
        intake: Intake,
        on_flush: Callable[["RecorderNode"], None] = lambda node: None,
        sites: Sequence[str] = (),
    ) -> None:
        """Prepare to record.

        Args:
            context: The clock, bus and machine of the node.
            config: The settings of the recorder.
            intake: The intake that writes the messages.
            on_flush: Called after each flush, for a status line and keys.
            sites: The sites whose nodes stop before this one, so that each must publish an end message.
        """
        self._intake = intake
        self._on_flush = on_flush
        self._sites = sites
        self._disk = DiskWatch(config.directory, context.machine.disk.free_bytes)
        self._reported_state = ""
        self._reported_removed = 0
        self._remind_ns = 0
        super().__init__(context)
        self.state = "running"
        self._flush_deadline = PeriodicDeadline(self.clock.monotonic_ns(), round(config.flush_interval_s * 1e9))
        self._path = "" if intake.writer is None else str(intake.writer.path)
        self._reported_path = ""
        self._reported_lost = 0
        self._reported_dropped = 0
        self._rate_start = (self.clock.monotonic_ns(), 0)
        self.rate_hz = 0.0

    @property
    def steps(self) -> int:
        """Number of messages received, so that the rate in node/health is theirs."""
        return self._intake.received

    @steps.setter
    def steps(self, value: int) -> None:
        self._intake.received = value

    def on_message(self, received: Received) -> None:
        """Do nothing, because the bus has already recorded the message."""

    def deadline_ns(self) -> int:
        return self._flush_deadline.deadline_ns

    def on_deadline(self, now_ns: int) -> None:
        # Report the file before the flush, which may end it.
        self._report_path()
        self._intake.flush(now_ns)
        rotation = self._intake.rotation
        self._disk.check(now_ns, self._intake.size_bytes + (0 if rotation is None else rotation.finished_bytes))
        self._flush_deadline.advance(now_ns)
        self.overruns = self._flush_deadline.overruns
        self._measure(now_ns)
        self._report()
        self._on_flush(self)

    def on_control(self, control: SessionControl) -> str:
        """Record a mark, or with `set` begin a new file (`record.split`) or only return the status."""
        if control.command == "mark":
            return self._mark(control)
        if control.command != "set":
            return super().on_control(control)
        unknown = sorted(set(control.parameters) - set(ACTIONS))
        if unknown or not control.parameters:
            raise RefusedError(f"{', '.join(unknown) or 'nothing'} cannot be set: settable are {', '.join(ACTIONS)}")
        wrong = [name for name, value in control.parameters.items() if value is not True]
        if wrong:
            raise RefusedError(f"{', '.join(wrong)} must be true")
        if "record.split" in control.parameters:
            self.split()
        return self.status()

    @property
    def path(self) -> str:
        """Path of the current file, or of the last one."""
        return self._path

    def split(self) -> None:
        self._intake.split(self.clock.monotonic_ns())
        self._report()

    def status(self) -> str:
        """Return the state of the recording in one line: file, size, rate, losses."""
        intake = self._intake
        if intake.fault:
            return f"not recording: {intake.fault}"
        parts = [f"recording to {self._path}", f"{intake.size_bytes / 1e6:.1f} MB"]
        parts += [f"{intake.written} written", f"{self.rate_hz:.0f} messages/s", f"{intake.lost} lost"]
        parts += [f"{intake.rejected} rejected"] * (intake.rejected > 0)
        parts += [self._disk.text] if self._disk.text else []
        return ", ".join(parts)

    def _mark(self, control: SessionControl) -> str:
        if self._intake.fault:
            raise RefusedError(f"the mark is not recorded: {self._intake.fault}")
        # Publish directly, because foreign parameters could clash with the keywords of `event`.
        self.publish(
            "session/event", id="", kind="mark", level="info", text="mark of the operator", data=control.parameters
        )
        return f"marked in {self._path or 'memory'}"

    def _measure(self, now_ns: int) -> None:
        since_ns, received = self._rate_start
        if now_ns - since_ns >= _RATE_PERIOD_NS:
            self.rate_hz = (self._intake.received - received) * 1e9 / (now_ns - since_ns)
            self._rate_start = (now_ns, self._intake.received)

    def make_safe(self) -> None:
        """Record the messages that still wait in the sockets, and finish the file."""
        self._drain_sockets()
        self._intake.finish()
        self._report()
        if self._path and not self._intake.fault:
            self._report_end()

    def _drain_sockets(self) -> None:
        begin_ns = self.clock.monotonic_ns()
        end_ns, report_ns, calm = begin_ns + _DRAIN_TIMEOUT_NS, begin_ns + _REPORT_PERIOD_NS, 0
        before = self._intake.received
        while calm < _CALM_PASSES and self.clock.monotonic_ns() < end_ns:
            received = self._intake.received
            for _ in self.context.bus.receive():
                pass
            if self.clock.monotonic_ns() >= report_ns:
                report_ns += _REPORT_PERIOD_NS
                self._report_drain((report_ns - begin_ns - _REPORT_PERIOD_NS) * 1e-9, self._intake.received - before)
            if self._intake.received - received >= _BACKLOG:
                calm = 0
                continue
            # Wait, because messages held back by publishers come after the I/O thread of ZeroMQ has run.
            calm += 1
            self.context.bus.wait(self.clock.monotonic_ns() + _PASS_NS)
        if calm < _CALM_PASSES:
            text = "the recording ends before all that had been sent was written: the machine was too busy"
            self._intake.notes.append(text)
            self.event("fault", "error", text, waited_s=_DRAIN_TIMEOUT_NS * 1e-9)
        elif silent := self._intake.silent_at_the_end(self._sites, self.clock.now_ns()):
            text = f"the end of {', '.join(silent)} did not reach the recorder: their last messages may be missing"
            self._intake.notes.append(text)
            self.event("fault", "error", text)

    def _report_drain(self, waited_s: float, written: int) -> None:
        limit_s = _DRAIN_TIMEOUT_NS * 1e-9
        text = f"writing what still waits: {written} messages in {waited_s:.0f} s, at most {limit_s:.0f} s"
        self.event("recording", "info", text, state="draining", path=self._path, written=written, waited_s=waited_s)

    def _report_path(self) -> None:
        intake = self._intake
        # Reported at a flush, when subscribers have had time to connect.
        self._path = self._path if intake.writer is None else str(intake.writer.path)
        if self._path != self._reported_path:
            self._reported_path = self._path
            self.event("recording", "info", f"recording to {self._path}", state="started", path=self._path)

    def _report(self) -> None:
        intake = self._intake
        self._report_removed()
        self._report_path()
        dropped = 0 if intake.rotation is None else intake.rotation.dropped
        if dropped > self._reported_dropped:
            self._reported_dropped = dropped
            self.event("recording", "warning", f"{dropped} old files were removed to keep the quota", dropped=dropped)
        self._report_state()
        if intake.lossless_lost > self._reported_lost:
            missing = intake.lossless_lost - self._reported_lost
            self._reported_lost = intake.lossless_lost
            text = f"{missing} messages of lossless topics did not reach the recorder"
            self.event("fault", "warning", text, missing=_count(missing))

    def _report_removed(self) -> None:
        if self._intake.removed > self._reported_removed:
            self._reported_removed = self._intake.removed
            self.event("recording", "error", self._intake.notes[-1], state="removed", path=self._path)

    def _report_state(self) -> None:
        """Report a recording that has stopped or soon will, and repeat this every second for later subscribers."""
        fault, low, now_ns = self._intake.fault, self._disk.text, self.clock.monotonic_ns()
        state = "failed" if fault else "disk_low" if low else ""
        level, text = "warning", low
        if fault:
            self.state = "safe"
            level, text = "error", f"recording stopped, the rig continues: {fault}"
        elif self._reported_state == "failed":
            self.state = "running"
            level, text, state = "info", f"recording goes on in {self._path}: {self._intake.notes[-1]}", "resumed"
        elif not low and self._reported_state == "disk_low":
            level, text, state = "info", "the disk has room again", "disk_ok"
        if state and state != self._reported_state:
            self.event("recording", level, text, state=state, path=self._path)
        elif state not in ("", "disk_ok", "resumed") and now_ns >= self._remind_ns:
            data = {"state": state, "path": self._path}
            text = text[:MAX_TEXT].encode(errors="replace").decode()
            # Publish without logging, because the log would only repeat it.
            self.publish("session/event", id="", kind="recording", level=level, text=text, data=data)
        else:
            return
        self._reported_state, self._remind_ns = state, now_ns + _REPORT_PERIOD_NS

    def _report_end(self) -> None:
        intake, writer = self._intake, self._intake.writer
        if writer is None:
            return
        self.event(
            "recording",
            "info",
            f"recorded {writer.messages} messages to {self._path}",
            state="finished",
            path=self._path,
            messages=writer.messages,
            size_bytes=writer.size_bytes,
            gaps=_count(intake.gaps),
            lost=_count(intake.lost),
            missing=_count(intake.missing),
            rejected=intake.rejected,
        )


def _count(count: int) -> int:
    return min(count, _GREATEST_COUNT)

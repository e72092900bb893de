"""The recorder as a node: it hears every node at its own endpoint and writes everything down."""

import time
from collections.abc import Iterator, Sequence
from typing import ClassVar

import zmq

from proto.messages import SessionControl
from services.recorder.config import RecorderConfig
from services.recorder.intake import Intake, Listener
from services.runtime.bus import Attendant, Publisher, Received, ZmqBus
from services.runtime.clock import Clock
from services.runtime.errors import RefusedError
from services.runtime.node import Node, NodeContext
from services.runtime.schedule import Grid

# how long the end may take to fetch what still waits in the sockets, seconds of it on a machine that was too busy;
# within the grace that a supervisor gives
_LAST_WORDS_NS = 20_000_000_000
_MEASURED_NS = 1_000_000_000
# to wake up for every message costs more than to write it, and takes its turn from the loop
_GATHERED_NS = 1_000_000
_ORDERS = ("record.split", "record.snapshot", "record.status")


class RecorderBus(ZmqBus):
    """A bus with a connection of its own to each publisher, so that the place where a message was heard is known."""

    def __init__(
        self,
        publisher: Publisher,
        listeners: Sequence[Listener],
        intake: Intake,
        clock: Clock,
        wake_descriptor: int,
        network: Attendant | None = None,
    ) -> None:
        super().__init__(publisher, [listener.subscriber for listener in listeners], clock, wake_descriptor, network)
        self._intake = intake
        self._listeners: dict[object, Listener] = {listener.subscriber.socket: listener for listener in listeners}
        # one poll over a dozen sockets takes 6 us, to ask each takes 19, and there is one for every message or two
        self._poller = zmq.Poller()
        for listener in listeners:
            self._poller.register(listener.subscriber.socket, zmq.POLLIN)
        for descriptor in (wake_descriptor, *self._network_descriptors):
            self._poller.register(descriptor, zmq.POLLIN)
        self._ready: list[tuple[object, int]] = []
        self._taken_ns = 0

    def receive(self) -> Iterator[Received]:
        """Record what has arrived; gives only commands, for the node to answer."""
        ready, self._ready = self._ready or self._poller.poll(0), []
        for socket, _ in ready:
            listener = self._listeners.get(socket)
            if listener is None:
                continue
            for frames, received_ns in listener.subscriber.receive_raw():
                received = self._intake.take(listener, frames, received_ns)
                if received is not None:
                    yield received

    def wait(self, deadline_ns: int) -> None:
        """Wait until something has arrived or the monotonic clock has reached `deadline_ns`.

        What comes within a millisecond is taken together: the time of reception is late by no more than that.
        """
        now_ns = self._clock.monotonic_ns()
        if self._taken_ns <= now_ns < self._taken_ns + _GATHERED_NS:
            time.sleep((self._taken_ns + _GATHERED_NS - now_ns) * 1e-9)
            now_ns = self._clock.monotonic_ns()
        self._taken_ns = now_ns
        remaining_ns = max(0, deadline_ns - now_ns)
        # rounded up, because waking a little early would only mean to wait once more
        self._ready = self._poller.poll(0 if self._attend else -(-remaining_ns // 1_000_000))
        if self._network_descriptors:
            self._attend = self._attend or any(socket in self._network_descriptors for socket, _ in self._ready)


class RecorderNode(Node):
    """Flushes on a grid of deadlines, and says what becomes of the recording."""

    inputs: ClassVar[tuple[str, ...]] = ("session/control",)
    commands: ClassVar[tuple[str, ...]] = ("mark",)

    def __init__(self, context: NodeContext, config: RecorderConfig, intake: Intake) -> None:
        self._intake = intake
        super().__init__(context)
        self.state = "running"
        self._grid = Grid(self.clock.monotonic_ns(), round(config.flush_interval_s * 1e9))
        self._path = "" if intake.writer is None else str(intake.writer.path)
        self._announced_path = ""
        self._announced_fault = ""
        self._announced_lost = 0
        self._announced_dropped = 0
        self._measured = (self.clock.monotonic_ns(), 0)
        self.rate_hz = 0.0

    @property
    def steps(self) -> int:
        """Messages heard: theirs is the rate in node/health."""
        return self._intake.heard

    @steps.setter
    def steps(self, value: int) -> None:
        self._intake.heard = value

    def on_message(self, received: Received) -> None:
        """Nothing is left to do: the bus has recorded it."""

    def deadline_ns(self) -> int:
        """Give the time of the next flush."""
        return self._grid.deadline_ns

    def on_deadline(self, now_ns: int) -> None:
        """Flush, and report what has changed since the last time."""
        # the file that the flush may end is told of before
        self._announce()
        self._intake.flush(now_ns)
        self._grid.advance(now_ns)
        self.overruns = self._grid.overruns
        self._measure(now_ns)
        self._report()

    def on_control(self, control: SessionControl) -> str:
        """Take note of a mark; `set` begins a new file, writes a snapshot, or asks how the recording does."""
        if control.command == "mark":
            return self._mark(control)
        if control.command != "set":
            raise RefusedError(f"{self.context.key} knows mark and set, not {control.command}")
        unknown = sorted(set(control.parameters) - set(_ORDERS))
        if unknown or not control.parameters:
            raise RefusedError(f"{', '.join(unknown) or 'nothing'} cannot be set: known are {', '.join(_ORDERS)}")
        wrong = [name for name, value in control.parameters.items() if value is not True]
        if wrong:
            raise RefusedError(f"{', '.join(wrong)} is an order and takes true only")
        if "record.split" in control.parameters:
            self.split()
        if "record.snapshot" in control.parameters:
            self.snapshot()
        return self.status()

    @property
    def path(self) -> str:
        """File in hand, or the last one."""
        return self._path

    def split(self) -> None:
        """Go on in a new file; RecordingError says why that cannot be."""
        self._intake.split(self.clock.monotonic_ns())
        self._report()

    def snapshot(self) -> None:
        """Write what is kept in memory; RecordingError when nothing is."""
        self._intake.snapshot()

    def status(self) -> str:
        """Say in a line how the recording does: where, how much, how fast, what was lost."""
        intake = self._intake
        if intake.fault:
            return f"not recording: {intake.fault}"
        words = [f"recording to {self._path}" if intake.writer is not None else "waiting for a trigger"]
        words += [f"{intake.size_bytes / 1e6:.1f} MB"] * (intake.writer is not None)
        if intake.ring is not None:
            words.append(f"{len(intake.ring)} messages, {intake.ring.size_bytes / 1e6:.1f} MB in memory")
        words += [f"{intake.written} written", f"{self.rate_hz:.0f} messages/s", f"{intake.lost} lost"]
        words += [f"{intake.rejected} rejected"] * (intake.rejected > 0)
        return ", ".join(words)

    def _mark(self, control: SessionControl) -> str:
        if self._intake.fault:
            raise RefusedError(f"the mark is not recorded: {self._intake.fault}")
        # the parameters come from outside: as keywords of `event` they could clash with its own
        self.publish(
            "session/event", id="", kind="mark", level="info", text="mark of the operator", data=control.parameters
        )
        return f"marked in {self._path or 'memory'}"

    def _measure(self, now_ns: int) -> None:
        since_ns, heard = self._measured
        if now_ns - since_ns >= _MEASURED_NS:
            self.rate_hz = (self._intake.heard - heard) * 1e9 / (now_ns - since_ns)
            self._measured = (now_ns, self._intake.heard)

    def make_safe(self) -> None:
        """Take what still waits in the sockets and complete the file."""
        self._take_last_words()
        self._intake.finish()
        self._report()
        if self._path and not self._intake.fault:
            self._report_end()

    def _take_last_words(self) -> None:
        end_ns = self.clock.monotonic_ns() + _LAST_WORDS_NS
        heard = -1
        while heard != self._intake.heard and self.clock.monotonic_ns() < end_ns:
            heard = self._intake.heard
            for _ in self.context.bus.receive():
                pass
        if heard != self._intake.heard:
            text = "the recording ends before all that had been sent was written: the machine was too busy"
            self.event("fault", "error", text, waited_s=_LAST_WORDS_NS * 1e-9)

    def _announce(self) -> None:
        intake = self._intake
        # said after the first flush, when whoever listens has had the time to connect
        self._path = self._path if intake.writer is None else str(intake.writer.path)
        if self._path != self._announced_path:
            self._announced_path = self._path
            self.event("recording", "info", f"recording to {self._path}", state="started", path=self._path)

    def _report(self) -> None:
        intake = self._intake
        self._announce()
        dropped = 0 if intake.parts is None else intake.parts.dropped
        if dropped > self._announced_dropped:
            self._announced_dropped = dropped
            self.event("recording", "warning", f"{dropped} old files were removed for the quota", dropped=dropped)
        if intake.fault != self._announced_fault:
            self._announced_fault = intake.fault
            self.state = "safe"
            text = f"nothing is recorded any more, the rig goes on: {intake.fault}"
            self.event("recording", "error", text, state="failed", path=self._path, heard=intake.heard)
        if intake.lossless_lost > self._announced_lost:
            missing = intake.lossless_lost - self._announced_lost
            self._announced_lost = intake.lossless_lost
            text = f"{missing} control, event or scan messages did not reach the recorder"
            self.event("fault", "warning", text, missing=missing)

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
            gaps=intake.gaps,
            lost=intake.lost,
            rejected=intake.rejected,
        )

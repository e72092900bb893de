"""The recorder as a node: it hears every node at its own endpoint and writes everything down."""

from collections.abc import Iterator, Sequence
from typing import ClassVar

import zmq

from proto.messages import SessionControl
from services.recorder.config import RecorderConfig
from services.recorder.intake import Intake, Listener
from services.runtime.bus import Publisher, Received, ZmqBus
from services.runtime.clock import Clock
from services.runtime.errors import RefusedError
from services.runtime.node import Node, NodeContext
from services.runtime.schedule import Grid

# how long the end may take to fetch what still waits in the sockets
_LAST_WORDS_NS = 250_000_000


class RecorderBus(ZmqBus):
    """A bus with a connection of its own to each publisher, so that the place where a message was heard is known."""

    def __init__(
        self, publisher: Publisher, listeners: Sequence[Listener], intake: Intake, clock: Clock, wake_descriptor: int
    ) -> None:
        super().__init__(publisher, [listener.subscriber for listener in listeners], clock, wake_descriptor)
        self._intake = intake
        self._listeners: dict[object, Listener] = {listener.subscriber.socket: listener for listener in listeners}
        # one poll over a dozen sockets takes 6 us, to ask each takes 19, and there is one for every message or two
        self._poller = zmq.Poller()
        for listener in listeners:
            self._poller.register(listener.subscriber.socket, zmq.POLLIN)
        self._poller.register(wake_descriptor, zmq.POLLIN)
        self._ready: list[tuple[object, int]] = []

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
        """Wait until something has arrived or the monotonic clock has reached `deadline_ns`."""
        remaining_ns = max(0, deadline_ns - self._clock.monotonic_ns())
        # rounded up, because waking a little early would only mean to wait once more
        self._ready = self._poller.poll(-(-remaining_ns // 1_000_000))


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
        self._announced_start = False
        self._announced_fault = ""
        self._announced_lost = 0

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
        self._intake.flush()
        self._grid.advance(now_ns)
        self.overruns = self._grid.overruns
        self._report()

    def on_control(self, control: SessionControl) -> str:
        """Take note of a mark."""
        if control.command != "mark":
            raise RefusedError(f"{self.context.key} knows mark, not {control.command}")
        if self._intake.writer is None:
            raise RefusedError(f"the mark is not recorded: {self._intake.fault}")
        # the parameters come from outside: as keywords of `event` they could clash with its own
        self.publish(
            "session/event", id="", kind="mark", level="info", text="mark of the operator", data=control.parameters
        )
        return f"marked in {self._path}"

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

    def _report(self) -> None:
        intake = self._intake
        # said after the first flush, when whoever listens has had the time to connect
        if self._path and not self._announced_start:
            self._announced_start = True
            self.event("recording", "info", f"recording to {self._path}", state="started", path=self._path)
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

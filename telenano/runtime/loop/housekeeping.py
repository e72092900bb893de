"""What a loop does beside its turns: it looks after connections and paths, measures, reports and logs.

There is one rule: none of this ends the loop. All of it runs in `Housekeeping.attempt`. If the system refuses it, as
without a free descriptor or memory, on a full or a broken disk, or where /proc is gone, then its result is not known:
an event says so once, the loop goes on, and the task is tried again with the next report.

A turn of the node is no housekeeping. Its errors end the node, which then makes its device safe.
"""

import contextlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeVar

import zmq

from telenano.runtime.bus.bus import ConnectionEvent
from telenano.runtime.bus.places import PlaceNotice
from telenano.runtime.loop.deadlines import LatenessWindow
from telenano.runtime.loop.deferred import Task
from telenano.runtime.loop.log import RateLimitedLog
from telenano.runtime.loop.node import Node, NodeBus
from telenano.runtime.loop.realtime import RealtimeStatus
from telenano.wire import TOPICS
from telenano.wire.errors import described
from telenano.wire.messages import SUPERSEDED
from telenano.wire.nodes import DEVICES

# Errors by which the system refuses something.
SYSTEM_ERRORS = (OSError, MemoryError, zmq.ZMQError)
_ANSWER = "the answer to events of connections"
_NO_NOTICES: Sequence[ConnectionEvent] = ()
T = TypeVar("T")


def named(task: Task) -> str:
    """Return the words for a deferred task in a sentence, from the name of its function."""
    return f"the task {getattr(task, '__name__', 'without a name').strip('_').replace('_', ' ')!r}"


class Housekeeping:
    """The housekeeping of one loop.

    Args:
        node: The node of the loop.
        bus: The bus of the node.
        realtime: The scheduling that the process was granted, for the reports.
        note_alive: Called with each report of health.
        stop: Stops the device of the node; called with the reason.
    """

    def __init__(
        self,
        node: Node,
        bus: NodeBus,
        realtime: RealtimeStatus,
        note_alive: Callable[[], None],
        stop: Callable[[str], None],
    ) -> None:
        self.lateness = LatenessWindow()
        # Whether a message of every input with a declared rate has arrived.
        self.receives_all = False
        self._node, self._bus, self._realtime = node, bus, realtime
        self._note_alive, self._stop = note_alive, stop
        self._clock, self._machine = node.context.clock, node.context.machine
        self._limited_log = RateLimitedLog(node.context.log, self._clock)
        self._places, self._hearing = node.context.places, node.context.hearing
        self._stopped_for_place = False
        # The tasks whose last attempt failed.
        self._failed: set[str] = set()
        self._started_ns = self._reported_ns = self._clock.monotonic_ns()
        self._last_cpu_s = self._processor_time_s(0.0)
        self._health: dict[str, Any] = {}
        self._machine_facts: Mapping[str, Any] = {"pid": 0, "cpu_percent": 0.0, "memory_bytes": 0}
        self._last_steps = self._rejected_seen = 0

    @property
    def tasks(self) -> Sequence[Task]:
        """The tasks of a report, in their order."""
        return (self.measure_health, self.send_health, *(() if self._places is None else (self.look_after_places,)))

    def attempt(self, what: str, task: Callable[[], T], otherwise: T) -> T:
        """Run a task and return its result; if the system refuses it, return `otherwise`, and report that once.

        Args:
            what: The task in words, such as "the look at the paths of this process".
            task: The task.
            otherwise: The result if none is known.
        """
        try:
            result = task()
        except SYSTEM_ERRORS as error:
            self._note_refused(what, error)
            return otherwise
        if self._failed:
            self._note_done(what)
        return result

    def process_events(self) -> None:
        """Process the events of connections if there may be some, and publish the notices."""
        # This is `attempt` without its calls, because each turn of a loop does it, and most have nothing to process.
        try:
            notices = self._bus.process_events()
        except SYSTEM_ERRORS as error:
            self._note_refused(_ANSWER, error)
            return
        if notices:
            self._publish(notices)
        if self._failed:
            self._note_done(_ANSWER)

    def look_after_connections(self) -> None:
        """Look at all connections, process their events, and publish the notices."""
        look = partial(self._bus.process_events, now=True)
        self._publish(self.attempt("the look at connections", look, _NO_NOTICES))

    def _publish(self, notices: Sequence[ConnectionEvent]) -> None:
        for notice in notices:
            self._node.context.publish_event("network", notice.level, notice.text, notice.data)

    def look_after_places(self) -> None:
        """Make removed paths of this process again; stop a device that no stop could reach, because that failed."""
        if self._places is None:
            return
        for notice in self.attempt("the look at the paths of this process", self._places.look, list[PlaceNotice]()):
            self._node.on_place(notice)
        if self._places.given_up and not self._stopped_for_place and self._node.context.key in DEVICES:
            self._stop(f"this device has stopped, because no command could reach it: {self._places.obstacle}")
        self._stopped_for_place = self._places.given_up

    def measure_health(self) -> None:
        """Measure the fields of node/health, and begin a new interval."""
        node, now_ns = self._node, self._clock.monotonic_ns()
        self.look_after_connections()
        self._report_rejections()
        elapsed_s = max(now_ns - self._reported_ns, 1) * 1e-9
        cpu_s = self._processor_time_s(self._last_cpu_s)
        p50, p99, greatest = self.lateness.take()
        rejected, _ = self._bus.rejections()
        if node.stale:
            rejected["stale"] = node.stale
        measured = self.attempt(
            "the measurement of this process",
            lambda: self._machine.health(cpu_s - self._last_cpu_s, elapsed_s),
            self._machine_facts,
        )
        self._machine_facts = measured
        self._health = {
            "state": node.state,
            "uptime_s": (now_ns - self._started_ns) * 1e-9,
            "rate_hz": (node.steps - self._last_steps) / elapsed_s,
            "period_s": node.period_s,
            "lateness_p50_s": p50,
            "lateness_p99_s": p99,
            "lateness_max_s": greatest,
            "overruns": node.overruns,
            "rejected": rejected,
            "realtime": self._realtime.fifo,
            "memory_locked": self._realtime.memory_locked,
            "replay": node.replay,
            "inputs": self._bus.input_health(),
            **node.device_health(),
            **measured,
        }
        if self._hearing is not None and (deaf := self._hearing.deaf()):
            self._health["deaf_s"] = deaf
        self.receives_all = all(row.age_valid or not TOPICS[row.topic].rate_hz for row in self._health["inputs"])
        self._last_steps, self._last_cpu_s, self._reported_ns = node.steps, cpu_s, now_ns

    def send_health(self) -> None:
        """Publish node/health as it was measured."""
        self._note_alive()
        self._node.publish("node/health", **self._health)

    def _processor_time_s(self, otherwise: float) -> float:
        return self.attempt("the measurement of processor time", self._machine.processor_time_s, otherwise)

    def _report_rejections(self) -> None:
        rejected, last = self._bus.rejections()
        total = sum(rejected.values()) - rejected.get(SUPERSEDED, 0)
        if total > self._rejected_seen:
            self._limited_log.warning("rejected", f"refused: {last}", count=total - self._rejected_seen)
            self._rejected_seen = total

    def _note_refused(self, what: str, error: BaseException) -> None:
        if what not in self._failed:
            self._failed.add(what)
            text = f"{what} failed ({described(error)}): its result is not known, and the loop goes on"
            self._tell("warning", text, what, "not_known")

    def _note_done(self, what: str) -> None:
        if what in self._failed:
            self._failed.remove(what)
            self._tell("info", f"{what} works again", what, "known")

    def _tell(self, level: str, text: str, what: str, state: str) -> None:
        # The event may be refused by the system as well.
        with contextlib.suppress(*SYSTEM_ERRORS):
            self._node.event("fault" if level == "warning" else "node", level, text, task=what, state=state)

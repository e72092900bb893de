"""The base of nodes with any device: it rejects messages from recordings, and processes the device's reports.

Optional features of a device or its settings are parts of the node's step. The parts are assembled once, when the node
is built, so that no step has to check which features exist (ADR 0067).
"""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, TypeVar

from telenano.runtime.loop.node import Node, NodeContext
from telenano.wire.messages import NodeHealth, SessionControl
from telenano.wire.received import Received

# A measured number with its unit, which changes from one report to the next although nothing else does.
_MEASURED = re.compile(r"\d+(\.\d+)?(e[-+]?\d+)?(?= ?(ms|s|Hz|mm|nm|m|mN|nN|N|mV|V|A|%)\b)")
S = TypeVar("S")
M = TypeVar("M")


class StepPart(Generic[S, M]):
    """An optional part of a step `S` with memory `M`, around guard and device; it implements the methods it needs."""

    def prepare(self, step: S, memory: M) -> None:
        """Act on the output of the guard, before the device does."""

    def measure(self, step: S, memory: M) -> None:
        """Process the measurements, for the published state and for the guard at the next step."""

    def report(self, step: S, memory: M) -> None:
        """Publish further messages after the state."""


class Parts(Generic[S, M]):
    """The parts of a step as one, called in their order; methods that a part does not implement cost nothing."""

    def __init__(self, parts: Sequence[StepPart[S, M]]) -> None:
        self.prepare, self.measure, self.report = (_all(parts, name) for name in ("prepare", "measure", "report"))


def _all(parts: Sequence[StepPart[S, M]], name: str) -> Callable[[S, M], None]:
    calls = [getattr(part, name) for part in parts if getattr(type(part), name) is not getattr(StepPart, name)]

    def call(step: S, memory: M) -> None:
        for each in calls:
            each(step, memory)

    return call


class DeviceNode(Node):
    """A node with a device, which counts as simulated until `process_report` receives a report of a real one.

    The node rejects messages of publishers whose `node/health` is marked `replay`, unless `allow_replay`. A player
    publishes that mark before its first message. An emergency stop is obeyed from every sender.
    """

    def __init__(self, context: NodeContext, *, allow_replay: bool) -> None:
        super().__init__(context)
        self.period_s = context.period_s
        self.freshness.allow_replay = allow_replay
        # Publishers of a recording, and whether the first rejection of each was reported.
        self._replayed: dict[str, bool] = {}
        self.is_lost, self._device_text = False, ""
        self._device_health: dict[str, float | str] = {}
        self._ages_s: list[float] = []

    def admits(self, received: Received) -> bool:
        message = received.message
        if type(message) is NodeHealth:
            if not message.replay:
                # The live node publishes again.
                self._replayed.pop(message.src, None)
            elif not self.freshness.allow_replay:
                self._replayed.setdefault(message.src, False)
            return True
        is_reported = self._replayed.get(message.src)
        if is_reported is None or (type(message) is SessionControl and message.command == "estop"):
            return True
        if not is_reported:
            self._replayed[message.src] = True
            text = f"commands of {message.src} come from a recording and are rejected (allow_replay is false)"
            self.event("fault", "warning", text, source=message.src)
        return False

    def has_device(self, latency_s: float, calibration: str) -> None:
        """Report the delay that a real device declares [s] and the identity of its calibration in node/health."""
        self._device_health = {"device_latency_s": latency_s, "calibration": calibration}

    def device_health(self) -> Mapping[str, Any]:
        ages_s, self._ages_s = self._ages_s, []
        return {**self._device_health, **({"device_age_s": sum(ages_s) / len(ages_s)} if ages_s else {})}

    def process_report(self, report: Any, *, is_late: bool = False) -> None:
        """Record status and age_s of a report of a real device; publish its text as an event when it changes.

        Measured numbers do not count as a change: a driver that states the age of its sample would publish in each
        period. The end of a trouble is an event as well.

        Args:
            report: The report, with status, age_s and text.
            is_late: Whether the sample is too old, so that any text of the device is a fault.
        """
        self.is_lost = report.status == "lost"
        if not self.is_lost:
            self._ages_s.append(report.age_s)
        text = _MEASURED.sub("", report.text)
        if text != self._device_text:
            self._device_text = text
            is_ready = (report.status == "ok" and not is_late) or not report.text
            said = report.text or "the device answers again"
            self.event("node" if is_ready else "fault", "info" if is_ready else "warning", said)

"""Trace the time of a node by part of a hop, for `loop.py`, which starts its rigs with `traced_node/sitecustomize.py`.

`install` replaces methods of the bus by timed ones in the process that calls it.
"""

import functools
import statistics
import time
from collections.abc import Callable
from typing import Any

from telenano.runtime.bus.bus import Subscriber, ZmqBus
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.loop.log import StructuredLog

# The parts in the order of a hop; `act` is all other work of a node: its step, the journal, the loop around both.
PARTS = ("take", "decode", "act", "build", "send", "after")
_TIMED = (
    (Subscriber, "receive_raw", "take"),
    (Subscriber, "take", "decode"),
    (ZmqPublisher, "publish", "build"),
    (ZmqPublisher, "send", "send"),
)
# So many hops are half a minute of a node at 1 kHz.
_MOST_HOPS = 60_000


class HopTrace:
    """Records the time of each part of a hop [ns], from the end of a wait to the beginning of the next one.

    A hop is a turn in which the process sent something. The time since its last message, `after`, delays that message
    if sender and reader share a processor, because the thread that sends it has the sender's priority.
    """

    def __init__(self, clock_ns: Callable[[], int] = time.perf_counter_ns) -> None:
        self._clock_ns = clock_ns
        self._open: list[str] = ["act"]
        self._since_ns = clock_ns()
        self._spent_ns = dict.fromkeys(PARTS, 0)
        self._sent = False
        self.hops: list[tuple[int, ...]] = []

    def begin(self, part: str) -> None:
        """Charge the time from now on to a part, until that part ends."""
        self._charge()
        self._open.append(part)
        if part == "build":
            # The message before this one was not the last of the turn.
            self._spent_ns["act"] += self._spent_ns["after"]
            self._spent_ns["after"] = 0

    def end(self) -> None:
        """End the current part, and charge the time from now on to the part around it."""
        self._charge()
        self._sent = self._open.pop() == "send" or self._sent

    def wake(self) -> None:
        """Begin a turn."""
        self._charge()
        self._spent_ns = dict.fromkeys(PARTS, 0)
        self._sent = False

    def wait(self) -> None:
        """Complete a turn; it is a hop if something was sent."""
        self._charge()
        if self._sent and len(self.hops) < _MOST_HOPS:
            self.hops.append(tuple(self._spent_ns.values()))

    def medians_us(self) -> dict[str, float]:
        """Return the median of each part [us]; empty if there was no hop."""
        columns = zip(*self.hops, strict=True)
        return {part: statistics.median(spent) * 1e-3 for part, spent in zip(PARTS, columns, strict=False)}

    def _charge(self) -> None:
        now_ns = self._clock_ns()
        part = self._open[-1]
        if part == "act" and self._sent:
            part = "after"
        self._spent_ns[part] += now_ns - self._since_ns
        self._since_ns = now_ns


def install(log: StructuredLog) -> Callable[[], None]:
    """Time the bus of this process from now on.

    Returns a function that writes the medians to the log and restores the bus.
    """
    trace = HopTrace()
    replaced: list[tuple[type, str, Any]] = [(ZmqBus, "wait", ZmqBus.wait)]
    wait = ZmqBus.wait

    def timed_wait(bus: ZmqBus, deadline_ns: int) -> None:
        trace.wait()
        wait(bus, deadline_ns)
        trace.wake()

    setattr(ZmqBus, "wait", timed_wait)  # noqa: B010
    for owner, name, part in _TIMED:
        replaced.append((owner, name, vars(owner).get(name)))
        setattr(owner, name, _timed(trace, getattr(owner, name), part))

    def report() -> None:
        for owner, name, original in replaced:
            delattr(owner, name) if original is None else setattr(owner, name, original)
        log.info("time by part of a hop [us], median", hops=len(trace.hops), parts=trace.medians_us())

    return report


def _timed(trace: HopTrace, function: Callable[..., Any], part: str) -> Callable[..., Any]:
    @functools.wraps(function)
    def timed(*given: Any, **named: Any) -> Any:
        trace.begin(part)
        try:
            return function(*given, **named)
        finally:
            trace.end()

    return timed

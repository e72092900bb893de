"""The age of what a controller receives: past the deadline of its topic it is rejected, wherever it has waited."""

from typing import cast

from proto.messages import TeleopBackward, TeleopForward
from proto.topics import deadline_of
from services.runtime.bus.bus import Received
from services.runtime.loop.freshness import LOOP_DEADLINE_NS, HandAge, StallDetector, age_s
from services.runtime.loop.node import NodeContext

# oldest sample that a law may still take for the present
INSTRUMENT_DEADLINE_S = deadline_of("afm/state")
_SAMPLES_S = {topic: deadline_of(topic) for topic in ("haptic/state", "afm/state")}
_SIGNALS_S = {topic: deadline_of(topic) for topic in ("teleop/forward", "teleop/backward")}


class InputAge:
    """Judges the inputs of a controller by their age, and the process itself by the time between its turns.

    A sample of the device at this site counts from its time stamp. A signal of the other half counts from the hand's
    sample that it descends from, less what the link has delayed on purpose.
    """

    def __init__(self, context: NodeContext, now_ns: int) -> None:
        self._context = context
        self._hand_age = HandAge(context.key, now_ns)
        self._stalls = StallDetector()
        # topics whose newest message was rejected, and reported
        self._rejected: set[str] = set()
        self.deadline_ns = self._stalls.deadline_ns
        self.record = self._hand_age.record

    def stalled(self, now_ns: int) -> bool:
        """Return whether this process stood still until now [ns], and report it."""
        if now_ns - self._stalls.turn_ns <= LOOP_DEADLINE_NS:
            self._stalls.turn_ns = now_ns
            return False
        stalled_s = self._stalls.stalled_s(now_ns)
        if not stalled_s:
            return False
        # what waited meanwhile is rejected without a report of its own
        self._rejected.update(_SAMPLES_S, _SIGNALS_S)
        text = f"this process stalled for {stalled_s * 1e3:.0f} ms: it waits for fresh signals"
        self._context.event("fault", "warning", text, stalled_s=stalled_s)
        return True

    def sampled_ns(self, received: Received) -> int:
        """Return the time stamp of a sample of this site's device [ns]; of one from a recording, that of reception."""
        t_ns = received.message.t_ns
        return received.received_ns if self._hand_age.is_played(t_ns) else t_ns

    def rejects(self, received: Received) -> bool:
        """Return whether a sample or signal is past its deadline; the first of a row is reported."""
        topic = received.topic
        limit_s = _SIGNALS_S.get(topic)
        if limit_s is not None:
            signal = cast(TeleopForward | TeleopBackward, received.message)
            old_s = self._hand_age.age_s(received.received_ns, signal.hand_t_ns)
        else:
            limit_s = _SAMPLES_S.get(topic)
            if limit_s is None:
                return False
            old_s = age_s(received.received_ns, self.sampled_ns(received))
        if old_s > limit_s:
            self._report(received, old_s, limit_s)
            return True
        if self._rejected:
            self._rejected.discard(topic)
        return False

    def _report(self, received: Received, old_s: float, limit_s: float) -> None:
        topic, src = received.topic, received.message.src
        if topic not in self._rejected:
            self._rejected.add(topic)
            age = f"{old_s * 1e3:.0f} ms off, of {limit_s * 1e3:.0f} ms allowed"
            self._context.event(
                "fault", "warning", f"{topic} of {src} is {age}: it is rejected", topic=topic, source=src
            )

"""A service or board that answers twice, late, out of order or not at all, for tests of a driver.

A test of a driver controls the time, and lets its service return the time of measurement as the position. So it knows
the true age of every reading, and compares it with the age that the driver reports.
"""

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

HOSTILITIES = {
    "none": "each answer comes once, at once",
    "twice": "each answer comes again, a moment later",
    "late": "each answer comes 80 ms late",
    "held": "nothing comes for 0.2 s, and then all of it at once, again and again",
    "never": "no answer comes",
    "reordered": "each second answer comes behind the one that follows it",
    "pushed": "forty answers of before come at once, now and then, without a request",
    "repeated": "the same answer comes each time",
    "half": "the second half of each answer is lost",
}
_MS = 1_000_000
_LATE_NS = 80 * _MS
_HELD_NS = 200 * _MS
_AGAIN_NS = _MS // 2
# Number of earlier answers that come at once.
_PUSHED = 40


class HostileService:
    """Disturbed transmission of answers between a service and a driver.

    Args:
        kind: One of `HOSTILITIES`.
        begins_ns: The time from which on the answers are disturbed [ns].
    """

    def __init__(self, kind: str, begins_ns: int) -> None:
        if kind not in HOSTILITIES:
            raise ValueError(f"{kind} is not a hostility: known are {', '.join(HOSTILITIES)}")
        self.kind, self._begins_ns = kind, begins_ns
        self._due: list[tuple[int, bytes]] = []
        self._before: deque[bytes] = deque(maxlen=_PUSHED)
        self._kept: bytes | None = None
        self._count = 0

    def put(self, answer: bytes, now_ns: int) -> None:
        """Add an answer of the service at a time [ns]."""
        kind = self.kind if now_ns >= self._begins_ns else "none"
        self._count += 1
        if kind == "half":
            answer = answer[: len(answer) // 2]
        elif kind == "repeated":
            answer = self._kept = answer if self._kept is None else self._kept
        elif kind == "reordered" and self._kept is None:
            self._kept = answer
            return
        if kind != "never":
            held_ns = (now_ns // _HELD_NS + 1) * _HELD_NS
            self._due.append(({"late": now_ns + _LATE_NS, "held": held_ns}.get(kind, now_ns), answer))
        if kind == "twice":
            self._due.append((now_ns + _AGAIN_NS, answer))
        elif kind == "reordered" and self._kept is not None:
            self._due.append((now_ns, self._kept))
            self._kept = None
        elif kind == "pushed" and self._count % _PUSHED == 0:
            self._due += [(now_ns + _AGAIN_NS, before) for before in self._before]
        self._before.append(answer)

    def take(self, now_ns: int) -> list[bytes]:
        """Return and remove the answers that have arrived at the driver by a time [ns]."""
        come = [answer for due_ns, answer in self._due if due_ns <= now_ns]
        self._due = [(due_ns, answer) for due_ns, answer in self._due if due_ns > now_ns]
        return come

    def forget(self) -> None:
        """Drop the answers in transit, as when a connection ends."""
        self._due.clear()


class TakenReading(NamedTuple):
    """A reading: the age that the driver reports and the true one [s], and whether the driver calls it good."""

    reported_age_s: float
    true_s: float
    is_good: bool


def unseen(readings: Iterable[TakenReading], limit_s: float = 0.05) -> list[TakenReading]:
    """Return the readings older than a limit [s] that the driver reports as good and not older than the limit."""
    return [reading for reading in readings if reading.is_good and reading.reported_age_s <= limit_s < reading.true_s]

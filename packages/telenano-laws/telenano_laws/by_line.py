"""Choice of the law by the line: measure the line, and change to the first law of a list that tolerates it.

The measurements are those in `law/status` of the master half and in `node/health` of both halves, so they describe the
session's own line, without a probe. A law tolerates a line if its stiffness limit over such a line (docs/passivity.md,
"How stiff a sample may be") is above the stiffness of the sample, and if the tip's answers are no older than the
greatest age at which the law was found to follow. The change is an ordinary `set law=...`, during which both devices
stand still for a round trip; it is requested only while the hand would move no further than `STOOD_M` in that time.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from telenano.sections import ControllerConfig

# The two halves of the law, and the nodes of the hand and of the tip.
MASTER = "controller@master"
SLAVE = "controller@slave"
HAND = "haptic_node@master"
TIP = "afm_node@slave"
TOPICS = ("law/status", "node/health", "haptic/state")
# Topic that each half of the law receives from the other one.
_CROSSING = {MASTER: "teleop/backward", SLAVE: "teleop/forward"}
# Least time between two changes of law.
DWELL_S = 10.0
# The line is judged by its behaviour over this time.
WINDOW_S = 10.0
# Greatest motion that a hand may lose by standing still [m], half of the distance that counts as a jump.
STOOD_M = 5e-5
# Time in which the hand coasts to rest, in addition to the round trip [s].
_COASTING_S = 0.02
# No change is requested while no answer has come for longer than this [s].
STALL_S = 0.05
# A silence of this length or more is a stall.
SILENT_S = 0.1
# Stalls are counted over this time.
STALLS_S = 60.0
# Signals whose ages differ by no more than this number of periods count as equally late.
_EVEN_PERIODS = 2.0


class Line(NamedTuple):
    """Statistics of a line over a window of time.

    Times in s: floor, the least age of the hand's sample that an answer responds to; median, slow and late, the 50th,
    90th and 99th percentile of these ages; silence, the longest time without an answer; seen, the observed time.
    lost: share of the signals that never came, in both directions together; stalls: their number in the last minute.
    """

    floor_s: float
    median_s: float
    slow_s: float
    late_s: float
    silence_s: float
    lost: float
    seen_s: float
    stalls: int = 0

    @property
    def spread_s(self) -> float:
        """Spread of the ages: the 90th percentile minus the least age [s]."""
        return self.slow_s - self.floor_s

    def is_even(self, period_s: float) -> bool:
        """Return whether no signal was lost or stalled and delays were equal within two periods (`period_s` in s)."""
        latest_s = max(self.late_s - self.floor_s, self.silence_s)
        return self.lost == 0.0 and self.stalls == 0 and latest_s <= _EVEN_PERIODS * period_s

    def __str__(self) -> str:
        """Return a description of the line for people."""
        return (
            f"floor {1e3 * self.floor_s:.3g} ms, spread {1e3 * self.spread_s:.3g} ms, longest silence"
            f" {1e3 * self.silence_s:.3g} ms, {self.stalls} stalls in a minute, {100.0 * self.lost:.2g} % lost"
        )


class Candidate(NamedTuple):
    """A law, and the lines for which it is wanted.

    longest_s: greatest median age of the answers [s]; the median, because a stall of some seconds does not change it.
    Within that, the law is wanted if the least age is at least `shortest_s` [s] and the spread at least
    `least_spread_s` [s], or if the last minute had `least_stalls` or more stalls.
    """

    law: str
    longest_s: float = math.inf
    shortest_s: float = 0.0
    least_spread_s: float = 0.0
    least_stalls: int = 0

    def unwanted(self, line: Line) -> str:
        """Return the reason why the law is not wanted over a line; empty if it is wanted."""
        if line.median_s > self.longest_s:
            return f"answers are {1e3 * line.median_s:.3g} ms old; it is used up to {1e3 * self.longest_s:.3g} ms"
        if self.least_stalls and line.stalls >= self.least_stalls:
            return ""
        if line.floor_s < self.shortest_s:
            return f"it is used for answers {1e3 * self.shortest_s:.3g} ms old or older"
        return (
            ""
            if line.spread_s >= self.least_spread_s
            else f"it is used for a spread of {1e3 * self.least_spread_s:.3g} ms or more"
        )


# In the order of preference. bounded_model holds the hand back by the delay of the line, and so for seconds after a
# stall; model_mediated does not, and has the least tracking error over lines whose delay wanders, as that of Starlink,
# or that stall now and then. Over all other lines bounded_model has the least, up to ages at which it has 0.35.
# passivity is last: it follows late, but over any line.
CANDIDATES = (
    Candidate("model_mediated", 0.2, shortest_s=0.02, least_spread_s=0.02, least_stalls=2),
    Candidate("bounded_model", 0.7),
    Candidate("passivity"),
)


class Decision(NamedTuple):
    """The law to change to, and the reason as a sentence."""

    law: str
    reason: str


class LineWindow:
    """Observes the line over the last seconds, from the reports of both halves of the law."""

    def __init__(self, window_s: float = WINDOW_S) -> None:
        """Prepare an empty window of the given length [s]."""
        self._window_s = window_s
        self._ages: deque[tuple[float, float, float]] = deque()
        self._stalls_s: deque[float] = deque()
        # For each half: time [s], and signals received and lost since its start.
        self._counts: dict[str, deque[tuple[float, int, int]]] = {half: deque() for half in _CROSSING}

    def forget(self) -> None:
        """Forget the ages, because a half that restarts has heard nothing yet; the stalls of its line still count."""
        self._ages.clear()

    def add_age(self, time_s: float, age_s: float, silence_s: float) -> None:
        """Add the age of the hand's sample that the newest answer responds to, and the time since that answer [s]."""
        if silence_s >= SILENT_S and (not self._ages or self._ages[-1][2] < SILENT_S):
            self._stalls_s.append(time_s)
        while self._stalls_s and self._stalls_s[0] < time_s - STALLS_S:
            self._stalls_s.popleft()
        self._ages.append((time_s, age_s, silence_s))
        while self._ages[0][0] < time_s - self._window_s:
            self._ages.popleft()

    def add_counts(self, half: str, time_s: float, inputs: Sequence[Any]) -> None:
        """Add the numbers of signals that a half has received and lost since its start, from its `node/health`."""
        for row in inputs:
            if row.topic == _CROSSING[half]:
                counts = self._counts[half]
                if counts and time_s < counts[-1][0]:
                    # The clock was set back, or the half restarted: earlier entries would never become old enough.
                    counts.clear()
                counts.append((time_s, row.received, row.lost))
                # Keep the newest entry before the window: counts within the window are differences to it.
                while len(counts) > 1 and counts[1][0] < time_s - self._window_s:
                    counts.popleft()

    def line(self) -> Line | None:
        """Return the statistics of the network line between the sites, or None before the first measured round trip."""
        if not self._ages:
            return None
        ages = sorted(age for _, age, _ in self._ages)
        received = sum(counts[-1][1] - counts[0][1] for counts in self._counts.values() if counts)
        # A restarted node counts from zero, so the difference may be negative.
        lost = sum(max(counts[-1][2] - counts[0][2], 0) for counts in self._counts.values() if counts)
        return Line(
            floor_s=ages[0],
            median_s=ages[len(ages) // 2],
            slow_s=ages[min(math.ceil(0.9 * len(ages)), len(ages) - 1)],
            late_s=ages[min(math.ceil(0.99 * len(ages)), len(ages) - 1)],
            silence_s=max(silence for _, _, silence in self._ages),
            lost=lost / (received + lost) if received > 0 else 0.0,
            seen_s=self._ages[-1][0] - self._ages[0][0],
            stalls=len(self._stalls_s),
        )


class Policy:
    """Decides from the messages of a rig which law suits its line; it only returns decisions, and sends nothing."""

    def __init__(
        self,
        controller: ControllerConfig,
        stiffness_n_per_m: float,
        candidates: Sequence[Candidate] = CANDIDATES,
        window_s: float = WINDOW_S,
    ) -> None:
        """Prepare to choose among laws.

        Args:
            controller: The section of the scenario, with the parameters of the laws.
            stiffness_n_per_m: The greatest stiffness that the tip can meet [N/m].
            candidates: The laws, the most wanted first.
            window_s: The time over which the line is observed [s].
        """
        self._stiffness_n_per_m, self.candidates = stiffness_n_per_m, tuple(candidates)
        self._configs = {one.law: controller.model_copy(update={"law": one.law}) for one in candidates}
        self._period_s, self._window_s = controller.period_s, window_s
        self._window = LineWindow(window_s)
        self._law, self._since_s, self._refused = "", -math.inf, dict[str, str]()
        self._asked_s, self._looked_s = -math.inf, -math.inf
        self._newest_s = -math.inf
        self._speed_m_per_s, self._latency_s = math.inf, 0.0

    @property
    def line(self) -> Line | None:
        """Statistics of the line over the window; None before the first answer."""
        return self._window.line()

    def doubts(self, candidate: Candidate, line: Line) -> str:
        """Return the reason why a law does not suit a line; empty if it does."""
        if text := self._refused.get(candidate.law):
            return text
        if text := candidate.unwanted(line):
            return f"law {candidate.law}: {text}"
        even = line.is_even(self._period_s)
        config = self._configs[candidate.law]
        if not config.stiffness_doubts(self._stiffness_n_per_m, self._latency_s, even=even):
            return ""
        line_text = "" if even else ", which loses or delays signals"
        return f"law {candidate.law} does not tolerate {self._stiffness_n_per_m:g} N/m over this line{line_text}"

    def refused(self, law: str, text: str) -> None:
        """Record that a node has refused a law, with its reason; the law is not requested again."""
        self._refused[law] = text

    def take(self, topic: str, src: str, time_s: float, message: Any) -> Decision | None:
        """Process a message that `src` sent at a time [s]; return a change of law that is due now, or None."""
        if topic == "haptic/state" and src == HAND:
            self._speed_m_per_s = abs(message.velocity_m_per_s[2])
        elif topic == "node/health" and src in _CROSSING:
            self._window.add_counts(src, time_s, message.inputs)
        elif topic == "node/health" and src == TIP:
            self._latency_s = message.device_latency_s or 0.0
        elif topic == "law/status" and src == MASTER:
            return self._with_status(time_s, message)
        return None

    def _with_status(self, time_s: float, status: Any) -> Decision | None:
        if time_s < self._newest_s:
            # The clock was set back, so earlier times cannot be compared with those that follow.
            self._window = LineWindow(self._window_s)
            self._since_s, self._asked_s, self._looked_s = time_s, -math.inf, -math.inf
        self._newest_s = time_s
        if status.law != self._law or status.switching:
            # The least time to the next change counts from every change, whoever made it, and from the first report.
            self._since_s, self._law = time_s, status.law
            self._window.forget()
            return None
        if not (status.heard and status.round_trip_valid):
            return None
        self._window.add_age(time_s, status.round_trip_s, status.silence_s)
        due = time_s - max(self._since_s, self._asked_s) >= DWELL_S
        # Sorting the window for each of a hundred reports per second would be useless work.
        if not due or status.silence_s > STALL_S or time_s - self._looked_s < 0.1:
            return None
        self._looked_s = time_s
        line = self._window.line()
        if line is None or line.seen_s < 0.9 * self._window_s:
            return None
        stands_s = line.late_s + _COASTING_S
        if self._speed_m_per_s * stands_s > STOOD_M:
            return None
        decision = self.decided(line)
        if decision is not None:
            self._asked_s = time_s
        return decision

    def decided(self, line: Line) -> Decision | None:
        """Return the first law that tolerates a line; None if it is the one in force, or if no law tolerates it."""
        against: list[str] = []
        for candidate in self.candidates:
            doubts = self.doubts(candidate, line)
            if not doubts:
                if candidate.law == self._law:
                    return None
                why = "; ".join(against) or f"law {candidate.law} is the first of those wanted"
                return Decision(candidate.law, f"{line}: {why}")
            against.append(doubts)
        return None


def facts_of(decision: Decision) -> Mapping[str, str]:
    """Return the parameters of the `mark` command that records a decision."""
    return {"law_by_line": decision.law, "reason": decision.reason}

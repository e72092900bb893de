"""Schedule of the link's clock questions to the other site: ten a second, and more while the line may have changed.

The present round trip follows from exchanges (`telenano.timing.line_present`), and ten of them a second would reveal a
longer route half a second late. Therefore an overdue answer, slow answers, or silence of the other half of the law
starts a series of questions 10 ms apart. It ends when the line proves unchanged or longer, at the latest after half a
second. The next series begins at least one second later, twice as late after each series without a result, and never
before an answer has come, so that a line that is cut or full gets no additional load.
"""

import msgspec

# Represents a time that never comes [ns].
NEVER_NS = 2**62
# Interval of the questions in a series [ns].
_APART_NS = 10_000_000
# Longest duration of a series, and first and longest pause after it [ns].
_SERIES_NS = 500_000_000
_PAUSE_NS = 1_000_000_000
_LONGEST_PAUSE_NS = 8_000_000_000
# Pause after a series that found the line unchanged or longer [ns].
_BREATH_NS = 200_000_000
# An answer is overdue after the round trip plus this time [ns].
_LATE_NS = 10_000_000
# The other half of the law is silent after this number of mean intervals of its messages, but at least `_SILENT_NS`.
_SILENT = 3
_SILENT_NS = 15_000_000
# If the mean interval of the law's messages exceeds this, their silence says nothing about the line [ns].
_SPARSE_NS = 50_000_000
_NEWEST_SHARE = 0.1
# Least number of answers in a series before the line counts as unchanged.
_ENOUGH = 5


class Questions(msgspec.Struct, array_like=True):
    """Schedule of the questions beyond the ten a second; times are of the monotonic clock [ns].

    unanswered_ns: send time of the first question since the last answer; until_ns: end of the present series; next_ns:
    its next question; rest_until_ns: earliest start of the next series; answers: number since the last series began;
    heard_ns, apart_ns: time of the newest message of the law's other half, and the mean interval of its messages;
    pause_ns: pause after a series without a result.
    """

    unanswered_ns: int = NEVER_NS
    until_ns: int = 0
    next_ns: int = 0
    rest_until_ns: int = 0
    answers: int = 0
    heard_ns: int = 0
    apart_ns: float = 0.0
    pause_ns: int = _PAUSE_NS

    def hear(self, now_ns: int) -> None:
        """Record a message of the other half of the law."""
        if self.heard_ns:
            self.apart_ns += _NEWEST_SHARE * (now_ns - self.heard_ns - self.apart_ns)
        self.heard_ns = now_ns

    def ask(self, now_ns: int) -> None:
        """Record a question that is sent."""
        self.unanswered_ns = min(self.unanswered_ns, now_ns)

    def answer(self, now_ns: int, *, in_doubt: bool, is_longer: bool) -> None:
        """Record an answer; `in_doubt`: the latest ones are slow; `is_longer`: the line has proved to be longer."""
        self.unanswered_ns = NEVER_NS
        self.answers += 1
        if now_ns < self.until_ns and (is_longer or (not in_doubt and self.answers >= _ENOUGH)):
            self.until_ns, self.rest_until_ns, self.pause_ns = now_ns, now_ns + _BREATH_NS, _PAUSE_NS
        elif in_doubt:
            self._begin(now_ns)
        elif now_ns >= self.until_ns:
            self.pause_ns = _PAUSE_NS

    def due_ns(self, round_trip_ns: int) -> int:
        """Return the time at which to call `take` [ns], given the present round trip [ns]."""
        if self.next_ns < self.until_ns:
            return self.next_ns
        if not self.answers:
            return NEVER_NS
        due_ns = NEVER_NS
        if self.unanswered_ns != NEVER_NS:
            due_ns = self.unanswered_ns + round_trip_ns + _LATE_NS
        if self.heard_ns and self.apart_ns < _SPARSE_NS:
            due_ns = min(due_ns, self.heard_ns + max(_SILENT_NS, round(_SILENT * self.apart_ns)))
        return due_ns if due_ns == NEVER_NS else max(due_ns, self.rest_until_ns)

    def take(self, now_ns: int, round_trip_ns: int) -> bool:
        """Return whether a question must be sent now, and schedule the next one."""
        if now_ns < self.due_ns(round_trip_ns):
            return False
        self._begin(now_ns)
        if now_ns >= self.until_ns:
            # The series is over. Its next question would remain due, and the loop would never wait.
            self.next_ns = self.until_ns
            return False
        self.next_ns = now_ns + _APART_NS
        return True

    def _begin(self, now_ns: int) -> None:
        if now_ns < self.rest_until_ns:
            return
        self.until_ns, self.next_ns = now_ns + _SERIES_NS, now_ns
        self.rest_until_ns = self.until_ns + self.pause_ns
        self.pause_ns = min(2 * self.pause_ns, _LONGEST_PAUSE_NS)
        self.answers = 0
        # One silence starts only one series.
        self.heard_ns = 0

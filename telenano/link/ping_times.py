"""When the link asks the other site for its time: ten times a second, and often while the line may have changed.

What the line takes now follows from exchanges (`telenano.timing.line_present`), and one in a tenth of a second would
tell of a longer route half a second late. So a question that is not answered when it should be, answers that came
later, or the silence of the other half of the law begins a series of questions a hundredth of a second apart. It ends
when the line is as it was or has been seen to be longer, and after half a second in any case. The next one then begins
a second later at the earliest, and after each that shows nothing twice as late, and never before an answer has come, so
that a line that is cut or full is left alone.
"""

import msgspec

# No time: a question is never due by itself [ns].
NEVER_NS = 2**62
# A question each [ns], within a series.
_APART_NS = 10_000_000
# A series lasts for this time at most, and the next one begins this long after it [ns].
_SERIES_NS = 500_000_000
_PAUSE_NS = 1_000_000_000
_LONGEST_PAUSE_NS = 8_000_000_000
# One that found the line unchanged, or longer, may be followed after this time [ns].
_BREATH_NS = 200_000_000
# An answer may be later by this than the line takes [ns].
_LATE_NS = 10_000_000
# A silence of the law is this number of mean distances of its messages, and at least that long [ns].
_SILENT = 3
_SILENT_NS = 15_000_000
# Messages of the law that are further apart than this show no change of the line by their silence [ns].
_SPARSE_NS = 50_000_000
_NEWEST_SHARE = 0.1
# A series has this number of answers at least before the line counts as unchanged.
_ENOUGH = 5


class Questions(msgspec.Struct, array_like=True):
    """When the next question is due beside the ten a second; times of the monotonic clock [ns].

    unanswered_ns: when the oldest question was sent that none after it was answered; until_ns: the end of the series
    under way; next_ns: its next question; rest_until_ns: no series begins before; answers: how many came since the last
    one began; heard_ns, apart_ns: the newest message of the other half of the law, and their mean distance; pause_ns:
    the pause behind a series that shows nothing.
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
        """Note a message of the other half of the law."""
        if self.heard_ns:
            self.apart_ns += _NEWEST_SHARE * (now_ns - self.heard_ns - self.apart_ns)
        self.heard_ns = now_ns

    def ask(self, now_ns: int) -> None:
        """Note a question that is sent."""
        self.unanswered_ns = min(self.unanswered_ns, now_ns)

    def answer(self, now_ns: int, *, in_doubt: bool, is_longer: bool) -> None:
        """Note an answer, whether those of late leave the line in doubt, and whether it is now seen to be longer."""
        self.unanswered_ns = NEVER_NS
        self.answers += 1
        if now_ns < self.until_ns and (is_longer or (not in_doubt and self.answers >= _ENOUGH)):
            self.until_ns, self.rest_until_ns, self.pause_ns = now_ns, now_ns + _BREATH_NS, _PAUSE_NS
        elif in_doubt:
            self._begin(now_ns)
        elif now_ns >= self.until_ns:
            self.pause_ns = _PAUSE_NS

    def due_ns(self, round_trip_ns: int) -> int:
        """Return when `take` is to be called [ns], for a line that takes so long."""
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
        """Return whether a question is to be sent now."""
        if now_ns < self.due_ns(round_trip_ns):
            return False
        self._begin(now_ns)
        if now_ns >= self.until_ns:
            # The series has ended before its next question, which would stay due and let the loop take turn after turn.
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
        # A silence begins one series.
        self.heard_ns = 0

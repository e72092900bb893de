"""The time span of most of a recording, and messages dated so far from it that a clock must have been wrong."""

from collections.abc import Sequence
from datetime import UTC, datetime
from typing import NamedTuple

# A recording has no longer pause between messages: one day [ns]. Each node reports its health twice a second.
LONGEST_PAUSE_NS = 86_400_000_000_000
_NS = 1_000_000_000
# The difference of two times before this fits a signed 64-bit integer [ns].
_LATEST_NS = 2**62


class MessageSpan(NamedTuple):
    """First and last time [ns] of a group of messages without a long pause, and their amount, as added."""

    first_ns: int
    last_ns: int
    amount: int


class Dates:
    """Amount of a recording that is dated to each day; the memory does not grow with the messages of a day."""

    def __init__(self) -> None:
        # Each day has its first and last time [ns], and its amount.
        self._days: dict[int, list[int]] = {}

    def add(self, first_ns: int, last_ns: int, amount: int) -> None:
        """Add messages without a long pause from a first to a last time [ns]; `amount` is a count or a size."""
        day = self._days.setdefault(first_ns // LONGEST_PAUSE_NS, [first_ns, last_ns, 0])
        if first_ns < day[0]:
            day[0] = first_ns
        if last_ns > day[1]:
            day[1] = last_ns
        day[2] += amount

    def groups(self) -> list[MessageSpan]:
        """Return the groups of messages between long pauses, in order of time."""
        dated: list[MessageSpan] = []
        for _, (first_ns, last_ns, amount) in sorted(self._days.items()):
            if dated and first_ns - dated[-1].last_ns <= LONGEST_PAUSE_NS:
                before = dated[-1]
                dated[-1] = MessageSpan(before.first_ns, max(before.last_ns, last_ns), before.amount + amount)
            else:
                dated.append(MessageSpan(first_ns, last_ns, amount))
        return dated

    def most(self) -> tuple[int, int]:
        """Return first and last time of the largest group [ns], or zeros if nothing was added.

        A group that ends after the year 2116 counts only if there is no other.
        """
        groups = self.groups()
        largest = max(
            groups, key=lambda each: (each.last_ns < _LATEST_NS, each[2], each[0]), default=MessageSpan(0, 0, 0)
        )
        return largest.first_ns, largest.last_ns


def odd_text(group: MessageSpan, example: str, span_ns: Sequence[int]) -> str:
    """Return a sentence on a group dated outside of the span of the others [ns], with one message as an example."""
    first, last = (datetime.fromtimestamp(at_ns // _NS, UTC).strftime("%Y-%m-%d %H:%M:%S") for at_ns in group[:2])
    is_before = group.last_ns < span_ns[0]
    away_ns = span_ns[0] - group.last_ns if is_before else group.first_ns - span_ns[1]
    days = f"{away_ns / LONGEST_PAUSE_NS:.0f} days {'before' if is_before else 'after'} the others"
    dated = f"{first} UTC" if group.first_ns == group.last_ns else f"{first} to {last} UTC"
    count = "1 message is" if group.amount == 1 else f"{group.amount} messages are"
    return f"{count} dated {dated}, {days} ({example}): start and duration are those of the others"

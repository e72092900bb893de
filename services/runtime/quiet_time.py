"""When a node of the loop reports: while none of its messages waits for it, and never two nodes in one tick.

A report takes as long as several turns. Made where it falls due it would delay the tick in hand, and all that follows.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from proto.nodes import START_ORDER

if TYPE_CHECKING:
    from services.runtime.bus import Received

HEALTH_PERIOD_NS = 500_000_000
# in the place of a topic: its own deadline ends the work of a tick at a node
OWN_DEADLINE = "own deadline"
# how long the end of a tick is waited for: a loop that stands still has no ticks
PATIENCE_NS = 20_000_000


class QuietTime:
    """Puts a report off until a tick has passed through its node, or has gone on from it for a while.

    Health and journal of each node have a part of the period of their own, on a clock that all of a machine share.
    """

    def __init__(self, node: str, last_of_tick: str, settle_ns: int) -> None:
        """Take the end of a tick from a topic; with none of it, which is no node of the loop, nothing is put off.

        Parameters: settle_ns, time after it that others have a use for the processor [ns].
        """
        self.last_of_tick = last_of_tick
        # a report is due and put off
        self.waits = False
        self.is_for_journal = False
        self._settle_ns = settle_ns
        self._has_passed = False
        self._health_due_ns = 0
        self._slot_ns = HEALTH_PERIOD_NS // (2 * len(START_ORDER))
        self._phase_ns = (2 * START_ORDER.index(node) if node in START_ORDER else 0) * self._slot_ns

    def put_off(self, taken: Sequence["Received"], now_ns: int, due_ns: int, *, had_deadline: bool) -> int:
        """Return when a report that is due may be made [ns]; `waits` is false when that is now.

        Parameters: taken, the messages of the turn in hand; had_deadline, a deadline was acted on in it; due_ns, when
        it was due or may be made at the latest.
        """
        if not self.last_of_tick:
            return due_ns
        by_message = any(received.topic == self.last_of_tick for received in taken)
        if not self._has_passed and (by_message or (had_deadline and self.last_of_tick == OWN_DEADLINE)):
            self._has_passed = self.waits = True
            due_ns = now_ns + self._settle_ns
        elif not self.waits:
            self.waits = True
            due_ns = now_ns + PATIENCE_NS
        if now_ns >= due_ns:
            self.waits = self._has_passed = False
        return due_ns

    def after_health(self, now_ns: int, due_ns: int) -> int:
        """Return when the journal is due, which follows in a tick of its own; `due_ns`: when the next health would be.

        Of a node that reports twice a second that is moved to its own part of the period.
        """
        if due_ns - now_ns >= HEALTH_PERIOD_NS:
            due_ns -= (due_ns - self._phase_ns) % HEALTH_PERIOD_NS
            if due_ns - now_ns < HEALTH_PERIOD_NS // 2:
                due_ns += HEALTH_PERIOD_NS
        self.is_for_journal = True
        self._health_due_ns = due_ns
        return now_ns + min(self._slot_ns, (due_ns - now_ns) // 2)

    def after_journal(self) -> int:
        """Return when the next health is due."""
        self.is_for_journal = False
        return self._health_due_ns

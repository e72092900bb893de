"""The clock of the other site against this one, from exchanges of four time stamps.

A question leaves here at t1 (this clock), reaches the other site at t2 (its clock), the answer leaves there at t3 and
arrives here at t4. With the delays d_there and d_back and the other clock ahead by the offset o,

    t2 = t1 + d_there + o,    t4 = t3 + d_back - o,
    t3 - t4 <= o <= t2 - t1,  round trip = (t4 - t1) - (t3 - t2) = d_there + d_back        (RFC 5905, section 8).

Queues only ever add delay, so the fastest question and the fastest answer of each second are kept, and the line between
them has offset and drift (`telenano.timing.clock_fit`). Only the difference of the two least delays enters, and no
exchange can reveal it. Neither is below zero, so the error is never above half of their sum, the uncertainty that is
given. A way that becomes longer changes nothing of that. What the line takes now is another question, which the
exchanges of the last second answer (`telenano.timing.line_present`).
"""

from collections.abc import Iterable
from typing import NamedTuple

import msgspec

from telenano.timing.clock_fit import MOST_DRIFT, Bounds, ClockLine, are_apart
from telenano.timing.line_present import LinePresent
from telenano.wire.messages import LinkClock

# Two clocks that are not set drift apart by less between two exchanges of a second.
STEP_NS = 10_000_000
BLOCK_NS = 1_000_000_000
# Parts of this number of seconds show a change of the rate.
_LEAST_PART = 4
_TURN_NS = 100_000_000
# A clock that is ahead by so much more or less after it was set is worth telling of [s].
_TOLD_S = 1e-3
# The clock is looked at each second, mostly by the same exchanges: of an hour so many looks count.
_LOOKS = 150


class Offset(NamedTuple):
    """Estimate of the offset [s], the bound of its error [s], the least round trip of now [s], exchanges in view."""

    offset_s: float
    uncertainty_s: float
    round_trip_s: float
    exchanges: int


class Block(NamedTuple):
    """The exchanges of a second.

    When the fastest question was sent, and its t2 - t1 [ns]; when the fastest answer arrived, and its t3 - t4 [ns]; how
    many exchanges there were.
    """

    asked_ns: int
    high_ns: int
    answered_ns: int
    low_ns: int
    exchanges: int

    def joined(self, other: "Block") -> "Block":
        """Return the block of the exchanges of both."""
        question = min((self.high_ns, self.asked_ns), (other.high_ns, other.asked_ns))
        answer = max((self.low_ns, -self.answered_ns), (other.low_ns, -other.answered_ns))
        return Block(question[1], question[0], -answer[1], answer[0], self.exchanges + other.exchanges)


class OffsetState(msgspec.Struct, array_like=True):
    """When the newest exchange was complete [ns], the drift shown last [s/s], the blocks in view, the line now.

    replaced: what the other clock was ahead, and its uncertainty [s], before a change that was not told of yet. The
    state of a recording of before may lack the last two.
    """

    newest_ns: int = 0
    drift: float = 0.0
    blocks: list[Block] = msgspec.field(default_factory=list)
    present: LinePresent = msgspec.field(default_factory=LinePresent)
    replaced: tuple[float, float] | None = None


class OffsetFilter:
    """The line through the exchanges of the last seconds; `present` is what an exchange takes at least now."""

    def __init__(self, window: int) -> None:
        """Keep the last `window` seconds that had exchanges; ValueError if fewer than one."""
        if window < 1:
            raise ValueError(f"window is {window}, must be at least 1 second")
        self._window = window
        self.restore(OffsetState())

    def restore(self, state: OffsetState) -> None:
        """Continue from a state and work on it."""
        self.state = state
        self._line: ClockLine | None = None

    @property
    def present(self) -> LinePresent:
        """What an exchange takes at least now."""
        return self.state.present

    def record(self, sent_ns: int, there_ns: int, back_ns: int, received_ns: int) -> bool:
        """Record an exchange; one whose round trip is negative cannot be one of ours and is ignored.

        An offset that no delay explains is that of another clock: the other site was started again after its wall clock
        was set. What is known of the clock before is then forgotten.

        Args:
            sent_ns: When the question was sent here [ns].
            there_ns: When it was received there, by the clock there [ns].
            back_ns: When the answer was sent there, by the clock there [ns].
            received_ns: When it was received here [ns].

        Returns:
            Whether the line is seen with it to have become longer.
        """
        if received_ns - sent_ns < back_ns - there_ns:
            return False
        block = Block(sent_ns, there_ns - sent_ns, received_ns, back_ns - received_ns, 1)
        if self.state.blocks and self._is_of_another_clock(block):
            self._note_replaced(self.line())
            self.state.blocks.clear()
            self.state.present = LinePresent(told_ns=self.present.told_ns)
        self._line = None
        self.state.newest_ns = received_ns
        if self.state.blocks and self.state.blocks[-1].answered_ns // BLOCK_NS == received_ns // BLOCK_NS:
            self.state.blocks[-1] = self.state.blocks[-1].joined(block)
        else:
            self.state.blocks.append(block)
            del self.state.blocks[: -self._window]
        return self.present.record(sent_ns, there_ns, back_ns, received_ns)

    def line(self) -> ClockLine | None:
        """Return the line of what the other clock is ahead, None before the first exchange.

        Where the other clock has changed its rate, or was set by little, the newest seconds count alone.
        """
        if self._line is None and self.state.blocks:
            self._line = self._fitted(self.state.blocks)
            while len(self.state.blocks) > 1 and (newest := self._newest_apart(self._line)):
                self._note_replaced(self._fitted(self.state.blocks[:-newest]))
                del self.state.blocks[:-newest]
                self._line = self._fitted(self.state.blocks)
            self.state.drift = self._line.drift
        return self._line

    def estimate(self) -> Offset | None:
        """Return the estimate for the time of the newest exchange, None before the first one."""
        line, present = self.line(), self.present.round_trip()
        if line is None or present is None:
            return None
        count = sum(block.exchanges for block in self.state.blocks)
        uncertainty_s = 0.5 * max(0.0, line.round_trip_ns * 1e-9)
        offset_s, round_trip_s = line.at(self.state.newest_ns) * 1e-9, present.now_ns * 1e-9
        return Offset(offset_s, uncertainty_s, round_trip_s, count)

    def there_ns(self) -> int | None:
        """Return t2 - t1 of the fastest question of the present [ns], which has the offset in it."""
        line, there = self.line(), self.present.there
        if line is None or there is None:
            return None
        return round(there.least_ns + line.drift * (self.state.newest_ns - there.at_ns))

    def report(self, *, of_line: bool = True) -> LinkClock:
        """Return what is known of the other clock, and of a line between two machines how well its round trip is."""
        offset, present = self.estimate(), self.present.round_trip()
        if offset is None or present is None:
            return LinkClock(valid=False, offset_s=0.0, uncertainty_s=0.0, round_trip_s=0.0, exchanges=0)
        return LinkClock(
            valid=True,
            offset_s=offset.offset_s,
            uncertainty_s=offset.uncertainty_s,
            # On one machine it is that of processes, which no route changes.
            round_trip_s=offset.round_trip_s if of_line else 2.0 * offset.uncertainty_s,
            exchanges=offset.exchanges,
            round_trip_low_s=present.low_ns * 1e-9 if of_line else None,
            round_trip_high_s=present.high_ns * 1e-9 if of_line else None,
            round_trip_since_ns=present.since_ns if of_line else None,
        )

    def take_change(self) -> tuple[Offset, Offset] | None:
        """Return what the other clock was ahead and is, where it was set and that was not told of yet."""
        replaced, now = self.state.replaced, self.estimate()
        # The estimate is what finds that a clock was set.
        replaced = replaced or self.state.replaced
        if replaced is None or now is None:
            return None
        self.state.replaced = None
        if abs(now.offset_s - replaced[0]) < _TOLD_S:
            return None
        return Offset(*replaced, now.round_trip_s, 0), now

    def _note_replaced(self, line: ClockLine | None) -> None:
        if line is not None and self.state.replaced is None:
            uncertainty_s = 0.5 * max(0.0, line.round_trip_ns * 1e-9)
            self.state.replaced = (line.at(self.state.newest_ns) * 1e-9, uncertainty_s)

    def _is_of_another_clock(self, block: Block) -> bool:
        last = self.state.blocks[-1]
        rise_ns = STEP_NS + MOST_DRIFT * abs(block.answered_ns - last.asked_ns)
        fall_ns = STEP_NS + MOST_DRIFT * abs(block.asked_ns - last.answered_ns)
        return block.low_ns > last.high_ns + rise_ns or block.high_ns < last.low_ns - fall_ns

    def _newest_apart(self, whole: ClockLine) -> int:
        """Return how many of the newest seconds are apart from those before; 0 where one line fits all of them."""
        half = len(self.state.blocks) // 2
        if whole.round_trip_ns < 0.0:
            return half
        # To try all parts at once would take milliseconds.
        sizes = [_LEAST_PART << n for n in range(half.bit_length()) if _LEAST_PART << n < half] + [half]
        newest = sizes[self.state.newest_ns // _TURN_NS % len(sizes)]
        if min(newest, len(self.state.blocks) - newest - 1) < _LEAST_PART:
            return 0
        # The second before the newest part may have exchanges of both.
        blocks = list(self.state.blocks)
        parts = [(self._fitted(part), _bounds_of(part)) for part in (blocks[: -newest - 1], blocks[-newest:])]
        return newest if are_apart(whole, parts, _LOOKS) else 0

    def _fitted(self, blocks: Iterable[Block]) -> ClockLine:
        return ClockLine.through(*_bounds_of(blocks), self.state.drift)


def _bounds_of(blocks: Iterable[Block]) -> Bounds:
    kept = tuple(blocks)
    upper = [(block.asked_ns, block.high_ns) for block in kept]
    return Bounds(upper, [(block.answered_ns, block.low_ns) for block in kept])

"""Offset of the other site's clock against this one, from exchanges of four time stamps.

A question leaves here at t1 (this clock) and reaches the other site at t2 (its clock); the answer leaves there at t3
and arrives here at t4. With the delays d_there and d_back and the other clock ahead by the offset o,

    t2 = t1 + d_there + o,    t4 = t3 + d_back - o,
    t3 - t4 <= o <= t2 - t1,  round trip = (t4 - t1) - (t3 - t2) = d_there + d_back        (RFC 5905, section 8).

Queues only add delay, so the fastest question and the fastest answer of each second are kept, and a line fitted between
them gives offset and drift (`telenano.timing.clock_fit`). The error is half the difference of the two least delays,
which no exchange can reveal. Neither delay is negative, so the error is at most half their sum, the reported
uncertainty. A route that becomes longer does not change that. The present round trip is estimated separately, from the
exchanges of the last second (`telenano.timing.line_present`).
"""

from collections.abc import Iterable
from typing import NamedTuple

import msgspec

from telenano.timing.clock_fit import MOST_DRIFT, Bounds, ClockLine, are_apart
from telenano.timing.line_present import LinePresent
from telenano.wire.messages import LinkClock

# Clocks that are not set drift apart by less than this between two exchanges of a second [ns].
STEP_NS = 10_000_000
BLOCK_NS = 1_000_000_000
# Least number of seconds in a part that can reveal a change of the rate.
_LEAST_PART = 4
_TURN_NS = 100_000_000
# Least change of the offset that is reported after a clock was set [s].
_TOLD_S = 1e-3
# Number of independent comparisons in an hour: the clock is checked each second, mostly from the same exchanges.
_LOOKS = 150


class Offset(NamedTuple):
    """Estimate of the offset [s], bound of its error [s], present least round trip [s], number of exchanges in view."""

    offset_s: float
    uncertainty_s: float
    round_trip_s: float
    exchanges: int


class Block(NamedTuple):
    """Summary of the exchanges of one second.

    asked_ns and high_ns: send time of the fastest question, and its t2 - t1 [ns]; answered_ns and low_ns: arrival time
    of the fastest answer, and its t3 - t4 [ns]; exchanges: their number.
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
    """Completion time of the newest exchange [ns], last proven drift [s/s], blocks in view, present state of the line.

    replaced: offset and uncertainty [s] before a change that is not reported yet. An older recording may lack the last
    two fields.
    """

    newest_ns: int = 0
    drift: float = 0.0
    blocks: list[Block] = msgspec.field(default_factory=list)
    present: LinePresent = msgspec.field(default_factory=LinePresent)
    replaced: tuple[float, float] | None = None


class OffsetFilter:
    """Estimates the other clock from the exchanges of the last seconds; `present` is the line's present round trip."""

    def __init__(self, window: int) -> None:
        """Use the last `window` seconds that had exchanges; raise ValueError if this is less than 1."""
        if window < 1:
            raise ValueError(f"window is {window}, must be at least 1 second")
        self._window = window
        self.restore(OffsetState())

    def restore(self, state: OffsetState) -> None:
        """Continue from a state, which is changed in place."""
        self.state = state
        self._line: ClockLine | None = None

    @property
    def present(self) -> LinePresent:
        """The estimate of the present least round trip."""
        return self.state.present

    def record(self, sent_ns: int, there_ns: int, back_ns: int, received_ns: int) -> bool:
        """Record an exchange; one with a negative round trip cannot be ours and is ignored.

        An offset that no delay explains means another clock: the other site was restarted after its wall clock was set.
        The knowledge of the earlier clock is then discarded.

        Args:
            sent_ns: Send time of the question, by the clock here [ns].
            there_ns: Reception of the question, by the clock there [ns].
            back_ns: Send time of the answer, by the clock there [ns].
            received_ns: Reception of the answer, by the clock here [ns].

        Returns:
            True if this exchange proves that the line has become longer.
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
        """Return the line of the other clock's lead; None before the first exchange.

        If the other clock changed its rate, or was set by a little, only the seconds after the change are used.
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
        """Return the estimate at the time of the newest exchange; None before the first one."""
        line, present = self.line(), self.present.round_trip()
        if line is None or present is None:
            return None
        count = sum(block.exchanges for block in self.state.blocks)
        uncertainty_s = 0.5 * max(0.0, line.round_trip_ns * 1e-9)
        offset_s, round_trip_s = line.at(self.state.newest_ns) * 1e-9, present.now_ns * 1e-9
        return Offset(offset_s, uncertainty_s, round_trip_s, count)

    def there_ns(self) -> int | None:
        """Return t2 - t1 of the present fastest question [ns], which includes the offset; None if unknown."""
        line, there = self.line(), self.present.there
        if line is None or there is None:
            return None
        return round(there.least_ns + line.drift * (self.state.newest_ns - there.at_ns))

    def report(self, *, of_line: bool = True) -> LinkClock:
        """Return the clock estimate for a status; with `of_line` also the interval of the line's round trip."""
        offset, present = self.estimate(), self.present.round_trip()
        if offset is None or present is None:
            return LinkClock(valid=False, offset_s=0.0, uncertainty_s=0.0, round_trip_s=0.0, exchanges=0)
        return LinkClock(
            valid=True,
            offset_s=offset.offset_s,
            uncertainty_s=offset.uncertainty_s,
            # On one machine the round trip is that between processes, which no change of route affects.
            round_trip_s=offset.round_trip_s if of_line else 2.0 * offset.uncertainty_s,
            exchanges=offset.exchanges,
            round_trip_low_s=present.low_ns * 1e-9 if of_line else None,
            round_trip_high_s=present.high_ns * 1e-9 if of_line else None,
            round_trip_since_ns=present.since_ns if of_line else None,
        )

    def take_change(self) -> tuple[Offset, Offset] | None:
        """Return the offsets before and after a change of the clock that is not reported yet; None if there is none."""
        replaced, now = self.state.replaced, self.estimate()
        # The call of `estimate` may have detected a change.
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
        """Return the number of newest seconds that need a line of their own; 0 if one line fits all of them."""
        half = len(self.state.blocks) // 2
        if whole.round_trip_ns < 0.0:
            return half
        # Try one size at a time, because all of them would take milliseconds.
        sizes = [_LEAST_PART << n for n in range(half.bit_length()) if _LEAST_PART << n < half] + [half]
        newest = sizes[self.state.newest_ns // _TURN_NS % len(sizes)]
        if min(newest, len(self.state.blocks) - newest - 1) < _LEAST_PART:
            return 0
        # Leave out the second before the newest part, which may have exchanges of both clocks.
        blocks = list(self.state.blocks)
        parts = [(self._fitted(part), _bounds_of(part)) for part in (blocks[: -newest - 1], blocks[-newest:])]
        return newest if are_apart(whole, parts, _LOOKS) else 0

    def _fitted(self, blocks: Iterable[Block]) -> ClockLine:
        return ClockLine.through(*_bounds_of(blocks), self.state.drift)


def _bounds_of(blocks: Iterable[Block]) -> Bounds:
    kept = tuple(blocks)
    upper = [(block.asked_ns, block.high_ns) for block in kept]
    return Bounds(upper, [(block.answered_ns, block.low_ns) for block in kept])

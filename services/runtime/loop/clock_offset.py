"""The offset between the clocks of the two sites, from exchanges of four time stamps.

A question leaves here at t1 (this clock), reaches the other site at t2 (its clock), the answer leaves there at t3 and
arrives here at t4. With the delays d_there and d_back and the other clock ahead by the offset o,

    t2 = t1 + d_there + o,    t4 = t3 + d_back - o,
    estimate  = ((t2 - t1) + (t3 - t4)) / 2 = o + (d_there - d_back) / 2,
    round trip = (t4 - t1) - (t3 - t2)       = d_there + d_back        (RFC 5905, section 8).

Only the difference of the two delays enters, and no exchange can reveal it: an asymmetric path shifts the estimate by
half of its asymmetry. Neither delay is below zero, so the error is never above half the round trip, which is the
uncertainty that is given. Queues only ever add delay, so of the last exchanges the one with the shortest round trip
is the one to believe (minimum filter).
"""

from collections import deque
from typing import NamedTuple

# Two clocks drift apart by less between two exchanges, and clocks are set by far more.
STEP_NS = 10_000_000


class Exchange(NamedTuple):
    """Four time stamps [ns]: sent here, received there, sent there, received here."""

    sent_ns: int
    received_there_ns: int
    sent_there_ns: int
    received_ns: int

    @property
    def offset_ns(self) -> float:
        """Offset of the other clock against this one [ns], positive when the other is ahead."""
        return 0.5 * ((self.received_there_ns - self.sent_ns) + (self.sent_there_ns - self.received_ns))

    @property
    def round_trip_ns(self) -> int:
        """Time on the way, both ways [ns], without the time spent at the other site."""
        return (self.received_ns - self.sent_ns) - (self.sent_there_ns - self.received_there_ns)


class Offset(NamedTuple):
    """Estimate of the offset [s], the bound of its error [s], the round trip [s] it rests on, exchanges in view."""

    offset_s: float
    uncertainty_s: float
    round_trip_s: float
    exchanges: int


class OffsetFilter:
    """Minimum filter over the last exchanges."""

    def __init__(self, window: int) -> None:
        """Keep the last `window` exchanges; ValueError if fewer than one."""
        if window < 1:
            raise ValueError(f"window is {window}, must be at least 1 exchange")
        self.exchanges: deque[Exchange] = deque(maxlen=window)

    def record(self, exchange: Exchange) -> None:
        """Record an exchange; one whose round trip is negative cannot be one of ours and is ignored.

        An offset that no delay explains is that of another clock: the other site was started anew after its wall clock
        was set. What is known of the clock before is then forgotten.
        """
        if exchange.round_trip_ns < 0:
            return
        if self.exchanges:
            last = self.exchanges[-1]
            explained_ns = 0.5 * (exchange.round_trip_ns + last.round_trip_ns) + STEP_NS
            if abs(exchange.offset_ns - last.offset_ns) > explained_ns:
                self.exchanges.clear()
        self.exchanges.append(exchange)

    def estimate(self) -> Offset | None:
        """Return the estimate, None before the first exchange."""
        if not self.exchanges:
            return None
        best = min(self.exchanges, key=lambda exchange: exchange.round_trip_ns)
        round_trip_s = best.round_trip_ns * 1e-9
        return Offset(best.offset_ns * 1e-9, 0.5 * round_trip_s, round_trip_s, len(self.exchanges))

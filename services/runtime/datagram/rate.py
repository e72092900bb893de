"""How much an end may send over a line that may be full: the rate control of GCC, driven by the standing queue.

The shape is that of Google Congestion Control (Carlucci, De Cicco, Holmer and Mascolo, "Analysis and design of the
Google congestion control for WebRTC", MMSys 2016): while a queue stands, the rate becomes a share of what was
delivered; else it grows. GCC infers the queue from its gradient; here `line.Line` gives the queue itself, so that the
threshold is one of delay, as in LEDBAT (RFC 6817). Losses without a queue change nothing: they do not mean that a line
is full.

A queue that does not fall although this end sends half of what it did is made by others, such as a TCP transfer in the
same buffer. To send still less would only give them the line, so that from then on losses decide, as they do in GCC:
the rate falls by half of the share lost where that is above 10 %, and grows where it is below 2 %.
"""

from collections import deque
from typing import Literal, NamedTuple

# Above the first the line is full, below the second it is not any more [ns].
FULL_NS, FREE_NS = 4_000_000, 2_000_000
# A queue that stands for so long is a fault to tell of [ns].
WARN_QUEUE_NS = 10_000_000
# What is sent of what was delivered, so that the queue drains; less by so much for each nanosecond above FULL_NS.
_SHARE, _LEAST_SHARE, _SHARE_PER_NS = 0.85, 0.5, 5e-9
# Growth in a second far from where the line was last full, and near it, from the first to the second share of it: there
# it begins slowly and is more by so much for each second since then, as that of CUBIC (RFC 9438).
_GROWTH, _CAREFUL_GROWTH, _MORE_PER_S, _NEAR, _PAST = 1.5, 1.03, 0.02, 0.8, 1.15
# Growth where it is known that the line carries more, after it was not full for so long.
_KNOWN_GROWTH, _CONTENDED_S = 2.5, 1.5
# The effect of a change shows after a round trip and the time over which a queue is judged.
_JUDGED_NS = 150_000_000
# A queue is not of this end's making if so much of it is left after this time, in which so much less was sent.
_LEFT, _PATIENCE_NS = 0.6, 1_000_000_000
# That is tried again after this time.
_SHARED_NS = 10_000_000_000
_MUCH_LOST, _LITTLE_LOST = 0.10, 0.02
_LOSS_PERIOD_NS = 500_000_000
# Over so long a time the delivered rate is judged.
_SPAN_NS = 300_000_000

Mode = Literal["free", "full", "shared"]


class Seen(NamedTuple):
    """What an end knows of the way that it sends on.

    queue_ns: the standing queue [ns]; delivered_bytes_per_s: what arrived there lately; loss_share: of what was sent
    lately, the share that did not; round_trip_ns: [ns].
    """

    queue_ns: int
    delivered_bytes_per_s: float
    loss_share: float
    round_trip_ns: int


class Delivery:
    """How fast datagrams are delivered, by what the other end says of them.

    Its clock times both ends of a span, so that neither an offset nor the way of the report matters. No more can have
    been delivered than was sent, whatever it says.
    """

    def __init__(self) -> None:
        self._marks: deque[tuple[int, int, int]] = deque()

    def record(self, heard_ns: int, expected: int, arrived: int) -> None:
        """Record that of so many `expected` so many had `arrived` when the newest came [ns]."""
        if self._marks and (expected < self._marks[-1][1] or heard_ns < self._marks[-1][0] - _SPAN_NS):
            # The other end, or its clock, is a new one.
            self._marks.clear()
        if not self._marks or heard_ns > self._marks[-1][0]:
            self._marks.append((heard_ns, expected, arrived))
        while len(self._marks) > 2 and heard_ns - self._marks[1][0] >= _SPAN_NS:
            self._marks.popleft()

    def rate(self, bytes_each: float, sent_bytes_per_s: float) -> tuple[float, float] | None:
        """Return delivered bytes in a second and the share lost; None before there is a span.

        Args:
            bytes_each: The mean size of what is sent [bytes].
            sent_bytes_per_s: What was sent lately [bytes/s].
        """
        if len(self._marks) < 2 or self._marks[-1][0] - self._marks[0][0] < _SPAN_NS // 2:
            return None
        (first_ns, expected, arrived), (last_ns, *last) = self._marks[0], self._marks[-1]
        came, sent = max(0, last[1] - arrived), last[0] - expected
        delivered = came * bytes_each / ((last_ns - first_ns) * 1e-9)
        return min(delivered, 1.5 * sent_bytes_per_s), min(1.0, max(0.0, 1.0 - came / sent)) if sent else 0.0


class RateControl:
    """The rate of one end; `bytes_per_s` is the most that it may send.

    `mode`: free, nothing limits it but the budget; full, a queue stood and the rate follows what is delivered; shared,
    the queue is made by others and losses decide.
    """

    def __init__(self, most_bytes_per_s: float) -> None:
        self.bytes_per_s = self.most_bytes_per_s = most_bytes_per_s
        # What the other end has measured of the line, 0 before that; it only says how fast the rate may grow.
        self.known_bytes_per_s = 0.0
        self.mode: Mode = "free"
        self._ready_ns = 0
        self._at_ns: int | None = None
        self._full_at: tuple[float, int] | None = None
        # The greatest queue of this time of full line, and when it began.
        self._worst: tuple[int, int] | None = None

    def update(self, now_ns: int, seen: Seen, least_bytes_per_s: float) -> None:
        """Take what is seen of the line now, some twenty times a second; never send less than the least."""
        elapsed_s = 0.0 if self._at_ns is None else min(1.0, max(0.0, (now_ns - self._at_ns) * 1e-9))
        self._at_ns = now_ns
        rate = self.bytes_per_s
        if seen.queue_ns < FREE_NS:
            self._worst = None
            if self.mode == "shared":
                self.mode = "full"
            if self.mode == "full" and now_ns >= self._ready_ns:
                rate *= self._growth(now_ns) ** elapsed_s
        elif self.mode == "shared":
            rate = self._by_losses(now_ns, rate, seen)
            if self._worst is not None and now_ns - self._worst[1] >= _SHARED_NS:
                # The others may have gone, and what stands now be of this end's making.
                self.mode, self._worst = "full", None
        elif seen.queue_ns >= FULL_NS and now_ns >= self._ready_ns:
            rate = self._at_a_queue(now_ns, rate, seen)
        self.bytes_per_s = min(self.most_bytes_per_s, max(rate, least_bytes_per_s))
        if self.mode == "full" and self.bytes_per_s >= self.most_bytes_per_s:
            self.mode = "free"

    def _at_a_queue(self, now_ns: int, rate: float, seen: Seen) -> float:
        self.mode = "full"
        self._ready_ns = now_ns + seen.round_trip_ns + _JUDGED_NS
        if self._worst is None:
            self._worst = seen.queue_ns, now_ns
            self._full_at = min(rate, seen.delivered_bytes_per_s), now_ns
        queue_ns, since_ns = self._worst
        # A queue at its worst takes so long to drain at the least share, and was not seen for a round trip.
        patience_ns = _PATIENCE_NS + 4 * queue_ns + 2 * seen.round_trip_ns
        if now_ns - since_ns >= patience_ns:
            self._worst = seen.queue_ns, now_ns
            if seen.queue_ns >= _LEFT * queue_ns:
                self.mode = "shared"
                return max(rate, 0.5 * self._full_at[0]) if self._full_at is not None else rate
        elif seen.queue_ns > queue_ns:
            self._worst = seen.queue_ns, since_ns
        share = max(_LEAST_SHARE, _SHARE - (seen.queue_ns - FULL_NS) * _SHARE_PER_NS)
        return min(rate, share * seen.delivered_bytes_per_s)

    def _by_losses(self, now_ns: int, rate: float, seen: Seen) -> float:
        if now_ns < self._ready_ns:
            return rate
        self._ready_ns = now_ns + max(_LOSS_PERIOD_NS, seen.round_trip_ns)
        if seen.loss_share > _MUCH_LOST:
            return rate * (1.0 - 0.5 * seen.loss_share)
        return rate * 1.05 if seen.loss_share < _LITTLE_LOST else rate

    def _growth(self, now_ns: int) -> float:
        if self._full_at is None:
            return _GROWTH
        full_at, since_s = self._full_at[0], (now_ns - self._full_at[1]) * 1e-9
        if since_s > _CONTENDED_S and self.bytes_per_s < _NEAR * self.known_bytes_per_s:
            # What made the line full then, beside this end, is gone.
            return _KNOWN_GROWTH
        if not _NEAR * full_at < self.bytes_per_s < _PAST * full_at:
            return _GROWTH
        return min(_GROWTH, _CAREFUL_GROWTH + _MORE_PER_S * since_s)

"""Tracking of sequence numbers: gaps, duplicates, late arrivals, and restarts of the publisher."""

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable
from enum import Enum, auto

# The largest count on the wire; counts saturate here, whatever numbers a peer sends.
MOST_COUNTED = 2**63 - 1
# A longer gap is counted whole, but late arrivals are recognised only in its newest part of this length.
_REMEMBERED_GAP = 4096
# This many messages in a row, in order and older than this [ns], are neither repeated nor late but a restart. The
# publisher's clock was set back, or a player replaced the publisher or an earlier replay, or an earlier number that was
# far ahead did not come from the publisher.
_REWIND_RUN = 8
_REWIND_NS = 1_000_000_000


def total(counts: Iterable[int]) -> int:
    """Return the sum of counts, limited to `MOST_COUNTED` as each of them is."""
    return min(sum(counts), MOST_COUNTED)


class Arrival(Enum):
    """Relation of a message to the earlier ones of its topic and source."""

    NEXT = auto()
    AFTER_GAP = auto()
    LATE = auto()
    DUPLICATE = auto()
    RESTART = auto()


_NEXT = Arrival.NEXT


class SequenceTracker:
    """Counts of the messages of one topic from one source.

    A lower `seq` with a later time stamp means that the publisher was restarted. With an earlier or equal stamp the
    message was overtaken, so it fills a gap and is no longer lost, or it came twice. A run of old messages in order is
    also a restart.
    """

    def __init__(self) -> None:
        self.received = 0
        self.lost = 0
        self.gaps = 0
        self.late = 0
        self.duplicates = 0
        self.restarts = 0
        # Messages that were received and counted, but not acted on, because a newer one was waiting.
        self.superseded = 0
        self.last_seq = -1
        self.last_t_ns = 0
        self.last_gap = (0, 0)
        self.ended = False
        self._run = 0
        self._run_at = (-1, 0)
        # First and last number of each gap, in order, and the numbers within them that came late.
        self._gaps: deque[tuple[int, int]] = deque()
        self._remembered = 0
        self._filled: set[int] = set()

    def accept(self, seq: int, t_ns: int) -> Arrival:
        """Count a message, from its seq and publisher's time [ns], and return its relation to the earlier ones."""
        if (seq == self.last_seq + 1 and not self.ended) or not self.received:
            self.received += 1
            self.last_seq = seq
            self.last_t_ns = t_ns
            return _NEXT
        arrival = self._classify(seq, t_ns)
        if arrival is Arrival.DUPLICATE:
            return arrival
        self.received += 1
        if arrival is not Arrival.LATE:
            self.last_seq = seq
            self.last_t_ns = t_ns
        return arrival

    def finish(self, sent: int) -> int:
        """Record that the publisher ended after `sent` messages; return the number of missing ones at the end.

        They count as lost. Later messages belong to the publisher's next process, whatever their number.
        """
        if not self.received:
            # Messages sent before the reader connected do not count as missing.
            return 0
        missing = max(0, sent - 1 - self.last_seq)
        if missing:
            self._open_gap(self.last_seq + 1, sent)
        self.ended = True
        return missing

    def _classify(self, seq: int, t_ns: int) -> Arrival:
        if self.ended and t_ns > self.last_t_ns:
            return self._restart()
        if seq > self.last_seq:
            self._open_gap(self.last_seq + 1, seq)
            return Arrival.AFTER_GAP
        if t_ns > self.last_t_ns:
            return self._restart()
        missing = self._is_missing(seq)
        # Any other message in between interrupts the run.
        self._run = self._run + 1 if (seq - 1, self.received) == self._run_at else 1
        self._run_at = (seq, self.received + missing)
        if self._run >= _REWIND_RUN and self.last_t_ns - t_ns > _REWIND_NS:
            return self._restart()
        if missing:
            self._filled.add(seq)
            self.lost -= self.lost < MOST_COUNTED
            self.late += 1
            return Arrival.LATE
        self.duplicates += 1
        return Arrival.DUPLICATE

    def _restart(self) -> Arrival:
        self.restarts += 1
        self.ended = False
        self._gaps.clear()
        self._filled.clear()
        self._remembered = 0
        return Arrival.RESTART

    def _is_missing(self, seq: int) -> bool:
        place = bisect_right(self._gaps, (seq, MOST_COUNTED)) - 1
        return place >= 0 and self._gaps[place][0] <= seq <= self._gaps[place][1] and seq not in self._filled

    def _open_gap(self, first: int, after: int) -> None:
        self.gaps += 1
        self.lost = min(self.lost + after - first, MOST_COUNTED)
        self.last_gap = (first, after - 1)
        start = max(first, after - _REMEMBERED_GAP)
        self._gaps.append((start, after - 1))
        self._remembered += after - start
        # The margin saves a reader on a bad link from this work at every gap.
        if self._remembered > 2 * _REMEMBERED_GAP:
            self._forget()

    def _forget(self) -> None:
        while self._remembered > _REMEMBERED_GAP:
            oldest, last = self._gaps.popleft()
            self._remembered -= last + 1 - oldest
        self._filled = {seq for seq in self._filled if self._gaps and seq >= self._gaps[0][0]}

"""Tracking of sequence numbers: gaps, duplicates, late arrivals, restarts of the publisher."""

from enum import Enum, auto

# a longer gap is counted whole, but only its newest part can still be recognised when it arrives late
_REMEMBERED_GAP = 4096
# so many repeated messages in a row, in order and this old, are not duplicates: the publisher's clock was set back, or
# a recording is played where its publisher, or an earlier replay, was received before
_REWIND_RUN = 8
_REWIND_NS = 1_000_000_000


class Arrival(Enum):
    """How a message relates to those before it."""

    NEXT = auto()
    AFTER_GAP = auto()
    LATE = auto()
    DUPLICATE = auto()
    RESTART = auto()


class SequenceTracker:
    """Counts of one topic from one source.

    A lower `seq` with a later time stamp means that the publisher was restarted; with an earlier or equal one, that
    the message was overtaken (it fills a gap, and is no longer lost) or came twice. A whole run of old ones in order
    is a restart as well.
    """

    def __init__(self) -> None:
        self.received = 0
        self.lost = 0
        self.gaps = 0
        self.late = 0
        self.duplicates = 0
        self.restarts = 0
        self.last_seq = -1
        self.last_t_ns = 0
        self.last_gap = (0, 0)
        self._run = 0
        self._run_at = (-1, 0)
        self._missing: set[int] = set()

    def accept(self, seq: int, t_ns: int) -> Arrival:
        """Record a message and return how it relates to those before it."""
        arrival = Arrival.NEXT
        if seq != self.last_seq + 1 and self.received:
            arrival = self._classify(seq, t_ns)
            if arrival is Arrival.DUPLICATE:
                return arrival
        self.received += 1
        if arrival is not Arrival.LATE:
            self.last_seq = seq
            self.last_t_ns = t_ns
        return arrival

    def _classify(self, seq: int, t_ns: int) -> Arrival:
        if seq > self.last_seq:
            self._open_gap(self.last_seq + 1, seq)
            return Arrival.AFTER_GAP
        if t_ns > self.last_t_ns:
            self.restarts += 1
            self._missing.clear()
            return Arrival.RESTART
        if seq in self._missing:
            self._missing.remove(seq)
            self.lost -= 1
            self.late += 1
            return Arrival.LATE
        # the run is broken by anything that was received in between
        self._run = self._run + 1 if (seq - 1, self.received) == self._run_at else 1
        self._run_at = (seq, self.received)
        if self._run >= _REWIND_RUN and self.last_t_ns - t_ns > _REWIND_NS:
            self.restarts += 1
            self._missing.clear()
            return Arrival.RESTART
        self.duplicates += 1
        return Arrival.DUPLICATE

    def _open_gap(self, first: int, after: int) -> None:
        self.gaps += 1
        self.lost += after - first
        self.last_gap = (first, after - 1)
        self._missing.update(range(max(first, after - _REMEMBERED_GAP), after))
        # with room to spare, so that a reader on a bad link does not sort at every gap
        if len(self._missing) > 2 * _REMEMBERED_GAP:
            self._missing = set(sorted(self._missing)[-_REMEMBERED_GAP:])

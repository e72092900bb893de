"""Tracking of sequence numbers: gaps, duplicates, late arrivals, and the processes of a publisher.

This is the one place that decides what begins and ends the numbers of a stream, for nodes, the recorder and readers of
recordings alike. Numbers begin at 0 in every process of a publisher, and `run` in the header tells its processes apart;
without it, which older and simpler programs do not send, their time stamps do. The end of whatever carries the messages
of others ends no numbers.
"""

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable
from enum import Enum, auto

# The largest count on the wire; counts saturate here, whatever numbers a peer sends.
MOST_COUNTED = 2**63 - 1
# A longer gap is counted whole, but late arrivals are recognised only in its newest part of this length.
_REMEMBERED_GAP = 4096
# Without `run`, this many messages in a row, in order and older than this [ns], are neither repeated nor late but a
# restart. The publisher's clock was set back, or a player replaced the publisher or an earlier replay, or an earlier
# number that was far ahead did not come from the publisher.
_REWIND_RUN = 8
_REWIND_NS = 1_000_000_000
# Earlier processes that are remembered: a link may deliver their last messages after the first of the next one.
_REMEMBERED_RUNS = 8


# seq, t_ns [ns] and run of a message.
Numbers = tuple[int, int, int | None]


def total(counts: Iterable[int]) -> int:
    """Return the sum of counts, limited to `MOST_COUNTED` as each of them is."""
    return min(sum(counts), MOST_COUNTED)


def run_at(time_ns: int) -> int:
    """Return the `run` of a publisher that begins at a time [ns]: its microseconds, modulo 2^32."""
    return time_ns // 1000 % 2**32


def is_other(run: int | None, than: int | None) -> bool:
    """Return whether two values of `run` are those of two processes; one that is absent tells nothing."""
    return run is not None and than is not None and run != than


def is_behind(message: Numbers, newest: Numbers) -> bool:
    """Return whether a message is no newer than another one of its topic and source."""
    (seq, t_ns, run), (newest_seq, newest_t_ns, newest_run) = message, newest
    return not is_other(run, newest_run) and seq <= newest_seq and t_ns <= newest_t_ns


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

    Another `run` means that the publisher was restarted; a run that was left is that of an overtaken message. Without
    `run`, a lower `seq` with a later time stamp means that. With an earlier or equal stamp the message was overtaken,
    so it fills a gap and is no longer lost, or it came twice. A run of old messages in order is also a restart.

    `counts_heads`: whether the numbers before the first message of a further process, known by its `run`, are a gap. A
    recorder counts them; to a node they are messages from before it was connected.
    """

    def __init__(self, *, counts_heads: bool = False) -> None:
        self.counts_heads = counts_heads
        self.received = 0
        self.lost = 0
        self.gaps = 0
        self.late = 0
        self.duplicates = 0
        self.restarts = 0
        # Messages that were received and counted, but not acted on, because a newer one was waiting.
        self.superseded = 0
        self.run: int | None = None
        self.last_seq = -1
        self.last_t_ns = 0
        self.last_gap = (0, 0)
        self.ended = False
        # The last number of the process before.
        self.left_seq = -1
        # Whether the newest restart has left a gap before its first number, which is `last_gap` then.
        self.lacks_head = False
        self._left: deque[int] = deque(maxlen=_REMEMBERED_RUNS)
        self._run = 0
        self._run_at = (-1, 0)
        # First and last number of each gap, in order, and the numbers within them that came late.
        self._gaps: deque[tuple[int, int]] = deque()
        self._remembered = 0
        self._filled: set[int] = set()

    def accept(self, seq: int, t_ns: int, run: int | None = None) -> Arrival:
        """Count a message, from its seq, publisher's time [ns] and run, and return its relation to the earlier ones."""
        if (seq == self.last_seq + 1 and run == self.run and not self.ended) or not self.received:
            self.received += 1
            self.run = run
            self.last_seq = seq
            self.last_t_ns = t_ns
            return _NEXT
        arrival = self._classify(seq, t_ns, run)
        if arrival is Arrival.DUPLICATE:
            return arrival
        self.received += 1
        if arrival is not Arrival.LATE:
            self.run = run
            self.last_seq = seq
            self.last_t_ns = t_ns
        return arrival

    def is_behind(self, seq: int, t_ns: int, run: int | None) -> bool:
        """Return whether a message is no newer than the newest received one."""
        return run in self._left or is_behind((seq, t_ns, run), (self.last_seq, self.last_t_ns, self.run))

    def finish(self, sent: int, run: int | None = None, *, ended: bool = True) -> int:
        """Count the messages up to `sent` that are missing at the end as lost, and return their number.

        Args:
            sent: The number of messages that the publisher, or the link that carried them, has sent.
            run: The process that ended, if known.
            ended: Whether the publisher itself has ended: later messages belong to its next process, whatever their
                number. After the end of a link, the numbers continue.
        """
        if not self.received or (run in self._left and run is not None):
            # Messages sent before the reader connected do not count as missing.
            return 0
        if ended and is_other(run, self.run):
            # Nothing of this process has been received.
            self._begin(run)
            self.last_seq = -1
        missing = max(0, sent - 1 - self.last_seq)
        if missing:
            self._open_gap(self.last_seq + 1, sent)
            self.last_seq = sent - 1
        self.ended = self.ended or ended
        return missing

    def _classify(self, seq: int, t_ns: int, run: int | None) -> Arrival:
        was_left = is_other(run, self.run)
        if was_left and run not in self._left:
            return self._restart(seq, run)
        if not was_left:
            is_told = run is not None and self.run is not None
            if not is_told and t_ns > self.last_t_ns and (self.ended or seq <= self.last_seq):
                return self._restart(seq, run)
            if seq == self.last_seq + 1:
                return _NEXT
            if seq > self.last_seq:
                self._open_gap(self.last_seq + 1, seq)
                return Arrival.AFTER_GAP
        missing = not was_left and self._is_missing(seq)
        # Any other message in between interrupts the run.
        self._run = self._run + 1 if (seq - 1, self.received) == self._run_at else 1
        self._run_at = (seq, self.received + missing)
        if self._run >= _REWIND_RUN and self.last_t_ns - t_ns > _REWIND_NS:
            return self._restart(seq, run)
        if missing:
            self._filled.add(seq)
            self.lost -= self.lost < MOST_COUNTED
        if missing or was_left:
            self.late += 1
            return Arrival.LATE
        self.duplicates += 1
        return Arrival.DUPLICATE

    def _restart(self, seq: int, run: int | None) -> Arrival:
        is_further = is_other(run, self.run)
        self._begin(run)
        self.lacks_head = is_further and self.counts_heads and seq > 0
        if self.lacks_head:
            self._open_gap(0, seq)
        return Arrival.RESTART

    def _begin(self, run: int | None) -> None:
        """Begin the numbers of another process."""
        self.restarts += 1
        if self.run is not None and is_other(run, self.run):
            self._left.append(self.run)
        self.run, self.ended, self.left_seq = run, False, self.last_seq
        self._gaps.clear()
        self._filled.clear()
        self._remembered = 0

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

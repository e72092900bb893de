"""Measure the capacity of the line over which an end receives.

Two things show the capacity: a train of datagrams sent back to back, which the line spreads, and a queue that the
samples have filled (`full_queue`). A train that arrives out of order or in bursts shows nothing, because jitter, a
stall or a step of the delay has spread it; nothing else is taken for the capacity. A measurement holds until more
arrives than it allows, or until the next one.
"""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

from telenano_wide_area.datagram.body import ASKING_TRAIN, TRAIN
from telenano_wide_area.datagram.full_queue import BESIDE_BIT_PER_S, FullQueue, Measured
from telenano_wide_area.datagram.outgoing import TRAIN_DATAGRAMS
from telenano_wide_area.datagram.pacing import NETWORK_BYTES

# A train begins after a pause of this length [ns].
_PAUSE_NS = 400_000_000
# A train of fewer datagrams than this shows nothing.
_FEWEST = 24
# A train that arrives faster than this is over before the clock of a process can show its duration [ns].
_SHORTEST_NS = 500_000
# A faster train cannot show in which order and how evenly it arrived [ns].
_EVEN_FROM_NS = 4_000_000
# If the line has spread a train, each third of it takes at least this share of a third of its time.
_EVEN = 0.6
# This number of datagrams of a train may come out of order.
_OVERTAKEN = 1
_RATE_SPAN_NS = 500_000_000
# The capacity is the greatest value that trains, or full queues, showed within this time, because other traffic makes a
# measurement smaller [ns].
_NOTED_NS = 10_000_000_000
_QUEUE_NOTED_NS = 2_000_000_000
# If more than this multiple of the capacity arrives, the line carries more than was measured.
_MORE = 1.1
# A change by this share, outside the interval of the old value, is reported once it has lasted for this time [ns].
_TOLD_SHARE = 0.25
_LASTED_NS = 1_000_000_000


class ArrivedDatagram(NamedTuple):
    """A datagram of a train: its time of arrival [ns], its number, and its size [bytes]."""

    at_ns: int
    number: int
    size_bytes: int


class Incoming:
    """The line from another machine, and its measured capacity."""

    def __init__(self, machine: str) -> None:
        self.machine = machine
        # Whether the other end has asked for a train, which is answered once.
        self.wants_train = False
        self._full = FullQueue()
        # The recent measurements by time [ns]; all by trains, or all by full queues.
        self._shown: dict[int, Measured] = {}
        # The greatest of them, the one reported last, and the time since when another one is measured [ns].
        self._best: Measured | None = None
        self._told: Measured | None = None
        self._other_since_ns: int | None = None
        self._by_queue = False
        self._train: list[ArrivedDatagram] = []
        self._span: tuple[int, int] | None = None
        self._bytes = 0
        self._number = -1

    @property
    def capacity(self) -> int:
        """The capacity of the line [bit/s], 0 where no train and no full queue has shown it."""
        return 0 if self._best is None else self._best.bit_per_s

    @property
    def measured(self) -> Measured | None:
        """The capacity of the line with its interval, None where no train and no full queue has shown it."""
        return self._best

    def take_change(self, now_ns: int) -> tuple[Measured, Measured] | None:
        """Return the previous and the present capacity if it has changed for good and that was not reported yet."""
        best, told = self._best, self._told
        if best is None or told is None:
            self._told = told or best
            return None
        if not _differ(told, best):
            self._other_since_ns = None
            return None
        if self._other_since_ns is None:
            self._other_since_ns = now_ns
        if now_ns - self._other_since_ns < _LASTED_NS:
            return None
        self._told, self._other_since_ns = best, None
        return told, best

    def record(self, size_bytes: int, now_ns: int, marks: Sequence[int], sent_ns: int, number: int) -> None:
        """Record a datagram that arrived.

        Args:
            size_bytes: Its size [bytes].
            now_ns: Its time of arrival [ns].
            marks: The marks among its samples.
            sent_ns: Its time of sending, by the other clock [ns].
            number: Its number in the sender's sequence.
        """
        size = size_bytes + NETWORK_BYTES
        self._bytes += size
        if self._train and (len(self._train) == TRAIN_DATAGRAMS or now_ns - self._train[-1].at_ns > _PAUSE_NS):
            self._end_train(now_ns)
        is_train = bool(marks) and marks[0] in (TRAIN, ASKING_TRAIN)
        if is_train or number < self._number:
            # A train is not paced like samples, and a queue keeps the order.
            self._full.forget()
        elif (rate := self._full.record(size, now_ns - sent_ns, now_ns)) is not None:
            self._show(now_ns, rate, by_queue=True)
        self._number = max(self._number, number)
        if is_train:
            if not self._train:
                self.wants_train = self.wants_train or marks[0] == ASKING_TRAIN
            self._train.append(ArrivedDatagram(now_ns, number, size))

    def measure(self, now_ns: int) -> None:
        """Forget the capacity if more arrives than it allows: how much more the line carries is then unknown."""
        if self._train and now_ns - self._train[-1].at_ns > _PAUSE_NS:
            self._end_train(now_ns)
        if self._span is None:
            self._span = now_ns, self._bytes
        begin_ns, begin_bytes = self._span
        if now_ns - begin_ns >= _RATE_SPAN_NS:
            carried = 8e9 * (self._bytes - begin_bytes) / (now_ns - begin_ns)
            if 0 < _MORE * self.capacity < carried:
                self._shown.clear()
                self._best = None
            self._span = now_ns, self._bytes

    def _end_train(self, now_ns: int) -> None:
        """Use the rate of a whole train, if only the line has spread it."""
        train, self._train = self._train, []
        if (rate := _spread(train)) is None:
            return
        self._show(now_ns, rate, by_queue=False)

    def _show(self, now_ns: int, rate: Measured, *, by_queue: bool) -> None:
        """Add a measurement; other traffic meanwhile makes it smaller than the capacity."""
        if by_queue != self._by_queue:
            self._shown.clear()
        self._by_queue = by_queue
        self._shown[now_ns] = rate
        lasts_ns = _QUEUE_NOTED_NS if by_queue else _NOTED_NS
        self._shown = {at_ns: shown for at_ns, shown in self._shown.items() if now_ns - at_ns <= lasts_ns}
        self._best = max(self._shown.values(), key=_rate)


def _rate(measured: Measured) -> int:
    return measured.bit_per_s


def _differ(before: Measured, after: Measured) -> bool:
    """Return whether two measurements differ by much and have no value in common."""
    lower, upper = sorted((before, after), key=_rate)
    apart = lower.high_bit_per_s is not None and lower.high_bit_per_s < upper.low_bit_per_s
    return apart and abs(after.bit_per_s - before.bit_per_s) > _TOLD_SHARE * before.bit_per_s


def _spread(train: Sequence[ArrivedDatagram]) -> Measured | None:
    """Return the rate at which a train arrived; None if something other than the line has spread it."""
    # The first datagram marks the begin of the others' arrival, and its own bytes were carried before that.
    count = len(train) - 1
    if count < _FEWEST:
        return None
    took_ns = train[-1].at_ns - train[0].at_ns
    bits = 8e9 * sum(one.size_bytes for one in train[1:])
    rate = round(bits / max(took_ns, _SHORTEST_NS))
    low = round(bits / (max(took_ns, _SHORTEST_NS) + _SHORTEST_NS))
    high = round(bits / (took_ns - _SHORTEST_NS)) if took_ns > 2 * _SHORTEST_NS else None
    if took_ns < _EVEN_FROM_NS:
        return Measured(rate, low, high)
    overtaken = sum(after.number < before.number for before, after in itertools.pairwise(train))
    ends = [train[round(count * third / 3)].at_ns for third in range(4)]
    thirds_ns = [end - begin for begin, end in itertools.pairwise(ends)]
    if overtaken > _OVERTAKEN or min(thirds_ns) < _EVEN * took_ns / 3:
        return None
    # Each third shows the rate as well, from a third of the datagrams.
    shares = [third_ns / (took_ns / 3) for third_ns in thirds_ns]
    highest = round(rate / min(shares)) + BESIDE_BIT_PER_S
    return Measured(rate, min(low, round(rate / max(shares))), highest if high is None else max(high, highest))

"""What an end learns of the line that it receives over, beside its queue: how much it carries, and when it is full."""

from collections.abc import Sequence

from services.runtime.datagram.body import ASKING_TRAIN, TRAIN
from services.runtime.datagram.outgoing import TRAIN_DATAGRAMS
from services.runtime.datagram.pacing import NETWORK_BYTES
from services.runtime.datagram.rate import FULL_NS, WARN_QUEUE_NS

# A queue is told of that stands for the first time, and again after the second [ns].
_STANDS_NS, _REMIND_NS = 1_000_000_000, 60_000_000_000
# A train begins after a pause, and fewer datagrams of one say nothing.
_PAUSE_NS, _FEWEST = 400_000_000, 10
# Faster than this a train is over before the clock of a process shows how long it took [ns].
_SHORTEST_NS = 500_000
_RATE_SPAN_NS = 500_000_000
# The most that was carried in this time is what the line carries [ns].
_NOTED_NS = 10_000_000_000


class Incoming:
    """The line from another machine. `capacity` is what it carries [bit/s], 0 until that is known."""

    def __init__(self, machine: str) -> None:
        self.machine = machine
        self.capacity = 0
        # Whether the other end has asked for a train, which is answered once.
        self.wants_train = False
        # What was carried since a time, and that time [ns].
        self._carried: dict[int, int] = {}
        # When each datagram of a train arrived [ns].
        self._train: list[int] = []
        self._span: tuple[int, int] | None = None
        self._bytes = 0
        self._full_since_ns: int | None = None
        self._told_ns: int | None = None

    def record(self, size_bytes: int, now_ns: int, marks: Sequence[int]) -> None:
        """Record a datagram that arrived; marks: what stands among its samples."""
        self._bytes += size_bytes + NETWORK_BYTES
        if not marks or marks[0] not in (TRAIN, ASKING_TRAIN):
            return
        if not self._train or now_ns - self._train[-1] > _PAUSE_NS:
            self._train.clear()
            self.wants_train = self.wants_train or marks[0] == ASKING_TRAIN
        if len(self._train) < TRAIN_DATAGRAMS:
            self._train.append(now_ns)
        # The first one tells when the others began to arrive, and was itself carried before.
        count = len(self._train) - 1
        if count >= _FEWEST:
            took_ns = max(self._train[-1] - self._train[0], _SHORTEST_NS)
            self._note(self._train[0], now_ns, round(8e9 * count * (size_bytes + NETWORK_BYTES) / took_ns))

    def told_of_queue(self, now_ns: int, queue_ns: int | None) -> tuple[str, str] | None:
        """Return level and text of an event when the line becomes full, still is after long, or no longer is."""
        self._measure(now_ns, queue_ns or 0)
        if queue_ns is None or queue_ns < WARN_QUEUE_NS:
            was_told, self._full_since_ns = self._told_ns is not None, None
            if not was_told or (queue_ns is not None and queue_ns >= FULL_NS):
                return None
            self._told_ns = None
            return "info", f"the line from {self.machine} is no longer full"
        if self._full_since_ns is None:
            self._full_since_ns = now_ns
        told_ns = self._told_ns
        if now_ns - self._full_since_ns < _STANDS_NS or (told_ns is not None and now_ns - told_ns < _REMIND_NS):
            return None
        self._told_ns = now_ns
        carries = f", which carries {self.capacity * 1e-6:.3g} Mbit/s of the link's datagrams" if self.capacity else ""
        queue = f"a queue of {queue_ns * 1e-6:.0f} ms stands before it"
        return "warning", f"the line from {self.machine}{carries}, is full: {queue}, and every sample is as much older"

    def _measure(self, now_ns: int, queue_ns: int) -> None:
        """Measure what is carried."""
        if self._span is None:
            self._span = now_ns, self._bytes
        begin_ns, begin_bytes = self._span
        if now_ns - begin_ns >= _RATE_SPAN_NS:
            # Without a queue the line may carry more, and does not carry less.
            carried = round(8e9 * (self._bytes - begin_bytes) / (now_ns - begin_ns))
            if queue_ns >= FULL_NS or 0 < self.capacity < carried:
                self._note(now_ns, now_ns, carried)
            self._span = now_ns, self._bytes

    def _note(self, since_ns: int, now_ns: int, bit_per_s: int) -> None:
        """Note what was carried since a time: what others sent as well makes that less than the line carries."""
        self._carried[since_ns] = bit_per_s
        self._carried = {at_ns: carried for at_ns, carried in self._carried.items() if now_ns - at_ns <= _NOTED_NS}
        self.capacity = max(self._carried.values(), default=bit_per_s)

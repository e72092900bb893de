"""What an end learns of the line that it receives over, beside its queue: how much it carries."""

from collections.abc import Sequence

from telenano_wide_area.datagram.body import ASKING_TRAIN, TRAIN
from telenano_wide_area.datagram.outgoing import TRAIN_DATAGRAMS
from telenano_wide_area.datagram.pacing import NETWORK_BYTES

# A train begins after a pause of this length.
_PAUSE_NS = 400_000_000
# A train of fewer datagrams than this says nothing.
_FEWEST = 10
# Faster than this a train is over before the clock of a process shows how long it took [ns].
_SHORTEST_NS = 500_000
_RATE_SPAN_NS = 500_000_000
# The most that was carried in this time is what the line carries [ns].
_NOTED_NS = 10_000_000_000


class Incoming:
    """The line from another machine.

    `measured` is what it was seen to carry [bit/s], 0 until that is known; `carried_while_full`, what its sender found
    that it carries, 0 while that does not take it for full.
    """

    def __init__(self, machine: str) -> None:
        self.machine = machine
        self.measured = self.carried_while_full = 0
        # Whether the other end has asked for a train, which is answered once.
        self.wants_train = False
        # What was carried since a time, and that time [ns].
        self._carried: dict[int, int] = {}
        # When each datagram of a train arrived [ns].
        self._train: list[int] = []
        self._span: tuple[int, int] | None = None
        self._bytes = 0

    @property
    def capacity(self) -> int:
        """What the line carries [bit/s], 0 until it is known: an old train says nothing of a line that is full."""
        return self.carried_while_full or self.measured

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

    def measure(self, now_ns: int) -> None:
        """Measure what is carried: where that is more than a train showed, the line carries more."""
        if self._span is None:
            self._span = now_ns, self._bytes
        begin_ns, begin_bytes = self._span
        if now_ns - begin_ns >= _RATE_SPAN_NS:
            carried = round(8e9 * (self._bytes - begin_bytes) / (now_ns - begin_ns))
            if 0 < self.measured < carried:
                self._note(now_ns, now_ns, carried)
            self._span = now_ns, self._bytes

    def _note(self, since_ns: int, now_ns: int, bit_per_s: int) -> None:
        """Note what was carried since a time: what others sent as well makes that less than the line carries."""
        self._carried[since_ns] = bit_per_s
        self._carried = {at_ns: carried for at_ns, carried in self._carried.items() if now_ns - at_ns <= _NOTED_NS}
        self.measured = max(self._carried.values(), default=bit_per_s)

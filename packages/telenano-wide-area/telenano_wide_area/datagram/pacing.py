"""How much is sent: a budget of bytes a second, and how many older samples each datagram repeats."""

from collections import deque

from telenano_wide_area.datagram.body import MOST_SAMPLE_BYTES
from telenano_wide_area.datagram.sealing import OVERHEAD_BYTES

MOST_REPEATS = 4
# a sample is repeated until fewer than this share of them are expected to be lost with all their copies
_ACCEPTED_LOSS = 1e-3
# The headers of UDP and IPv6 are this long; IPv4 has a shorter one.
NETWORK_BYTES = 48
# Repetitions leave so much of the budget to the newest message of every topic: two datagrams without any repetition.
RESERVE_BYTES = 1500
# reports of losses that count: some two seconds at two a second
_REPORTS = 4
# The whole budget may be saved up for this time.
_BURST_S = 0.02
# Of a smaller rate no more may be saved up than a datagram needs, and what comes in meanwhile from sample to sample.
_EVEN_S = 0.002


class SendBudget:
    """A token bucket of bytes, the headers of the network included."""

    def __init__(self, kbit_per_s: float, now_ns: int) -> None:
        self._all = self._bytes_per_s = kbit_per_s * 125.0
        self._most = self._most_of_all = max(self._all * _BURST_S, 2.0 * 1500.0)
        self.saved = self._most
        self._at_ns = now_ns

    def limit(self, bytes_per_s: float, bytes_each: float, now_ns: int) -> None:
        """Allow no more than a rate from now on.

        Below the whole budget there are no bursts, so that samples of `bytes_each` are evenly spaced.
        """
        self.left_bytes(now_ns)
        limited = bytes_per_s < self._all
        self._bytes_per_s = bytes_per_s
        self._most = bytes_each + bytes_per_s * _EVEN_S if limited else self._most_of_all
        self.saved = min(self.saved, self._most)

    def left_bytes(self, now_ns: int) -> float:
        """Return how many bytes a datagram sent now may have."""
        self.saved = min(self._most, self.saved + (now_ns - self._at_ns) * 1e-9 * self._bytes_per_s)
        self._at_ns = now_ns
        return self.saved - NETWORK_BYTES

    def spend(self, size_bytes: int) -> None:
        """Record a datagram that was sent."""
        self.saved -= size_bytes + NETWORK_BYTES


class Repeats:
    """The newest samples that were sent, and how many of them the next datagram carries again.

    The newest alone decides the age at the other end; a repetition is for those that want each sample, such as the
    recording, and for samples sent on change only.
    """

    def __init__(self, fixed: int | None) -> None:
        self.count = fixed or 0
        self.loss_share = 0.0
        self._fixed = fixed
        self._recent: deque[bytes] = deque(maxlen=MOST_REPEATS)
        self._reports: deque[tuple[int, int]] = deque(maxlen=_REPORTS)
        self._last = (0, 0)

    def with_repeats(self, sample: bytes, left_bytes: float) -> bytes:
        """Return a sample with as many older ones behind it as are wanted, fit and may be sent; remember it."""
        joined = sample
        if self.count:
            most = min(MOST_SAMPLE_BYTES, left_bytes - OVERHEAD_BYTES)
            for place in range(min(self.count, len(self._recent))):
                older = self._recent[place]
                if len(joined) + len(older) > most:
                    break
                joined += older
        self._recent.appendleft(sample)
        return joined

    def adapt(self, expected: int, arrived: int, *, full: bool = False) -> None:
        """Choose the count by what the other end says: how many arrived of those expected since the keys changed.

        Over a line that is full nothing is repeated: there it is the repetitions that are lost.
        """
        before = self._last
        self._last = (expected, arrived)
        if expected < before[0]:
            self._reports.clear()
            return
        self._reports.append((expected - before[0], max(0, arrived - before[1])))
        sent = sum(report[0] for report in self._reports)
        got = sum(report[1] for report in self._reports)
        if not sent:
            return
        self.loss_share = min(1.0, max(0.0, 1.0 - got / sent))
        if self._fixed is None:
            self.count = 0 if full else repeats_for(self.loss_share)

    def forget(self) -> None:
        """Forget the samples and what was reported: the other end is a new one."""
        self._recent.clear()
        self._reports.clear()
        self._last = (0, 0)


def repeats_for(loss_share: float) -> int:
    """Return the least number of repetitions after which few enough samples are lost, if losses are independent."""
    count = 0
    while count < MOST_REPEATS and loss_share ** (count + 1) > _ACCEPTED_LOSS:
        count += 1
    return count

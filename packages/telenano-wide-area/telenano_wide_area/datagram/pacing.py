"""Limits of sending: a budget of bytes a second, and the number of older samples that each datagram repeats."""

from collections import deque

from telenano_wide_area.datagram.body import MOST_SAMPLE_BYTES
from telenano_wide_area.datagram.sealing import OVERHEAD_BYTES

MOST_REPEATS = 4
# A sample is repeated until fewer than this share of samples are expected to be lost with all their copies.
_ACCEPTED_LOSS = 1e-3
# The length of the headers of UDP and IPv6 [bytes]; that of IPv4 is shorter.
NETWORK_BYTES = 48
# Repetitions leave this part of the budget to the newest message of every topic [bytes]: two datagrams without
# repetitions.
RESERVE_BYTES = 1500
# The number of reports of losses that count: some two seconds, at two a second.
_REPORTS = 4
# Unused budget is saved up for this time at most [s].
_BURST_S = 0.02
# At a smaller rate, no more is saved up than one datagram and the budget of this time between samples [s].
_EVEN_S = 0.002


class SendBudget:
    """A token bucket of bytes, including the headers of the network."""

    def __init__(self, kbit_per_s: float, now_ns: int) -> None:
        self._all = self._bytes_per_s = kbit_per_s * 125.0
        self._most = self._most_of_all = max(self._all * _BURST_S, 2.0 * 1500.0)
        self.saved = self._most
        self._at_ns = now_ns

    def limit(self, bytes_per_s: float, bytes_each: float, now_ns: int) -> None:
        """Limit the rate from now on.

        Below the whole budget there are no bursts, so that samples of `bytes_each` are evenly spaced.
        """
        self.left_bytes(now_ns)
        limited = bytes_per_s < self._all
        self._bytes_per_s = bytes_per_s
        self._most = bytes_each + bytes_per_s * _EVEN_S if limited else self._most_of_all
        self.saved = min(self.saved, self._most)

    def left_bytes(self, now_ns: int) -> float:
        """Return the largest size that a datagram sent now may have, without network headers [bytes]."""
        self.saved = min(self._most, self.saved + (now_ns - self._at_ns) * 1e-9 * self._bytes_per_s)
        self._at_ns = now_ns
        return self.saved - NETWORK_BYTES

    def spend(self, size_bytes: int) -> None:
        """Record a datagram that was sent."""
        self.saved -= size_bytes + NETWORK_BYTES


class Repeats:
    """The newest samples that were sent, and the number of them that the next datagram repeats.

    The newest sample alone decides the age at the other end; repetitions serve readers that need each sample, such as
    the recording, and samples that are sent on change only.
    """

    def __init__(self, fixed: int | None) -> None:
        self.count = fixed or 0
        self.loss_share = 0.0
        self._fixed = fixed
        self._recent: deque[bytes] = deque(maxlen=MOST_REPEATS)
        self._reports: deque[tuple[int, int]] = deque(maxlen=_REPORTS)
        self._last = (0, 0)

    def with_repeats(self, sample: bytes, left_bytes: float) -> bytes:
        """Return a sample followed by older ones, as many as are wanted, fit and may be sent; remember the sample."""
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
        """Choose the count by the other end's report: the arrivals among the expected datagrams since the keys changed.

        Over a full line nothing is repeated, because the repetitions themselves cause the losses there.
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
        """Forget the samples and the reports, because the other end is a new one."""
        self._recent.clear()
        self._reports.clear()
        self._last = (0, 0)


def repeats_for(loss_share: float) -> int:
    """Return the least number of repetitions with which few enough samples are lost, if losses are independent."""
    count = 0
    while count < MOST_REPEATS and loss_share ** (count + 1) > _ACCEPTED_LOSS:
        count += 1
    return count

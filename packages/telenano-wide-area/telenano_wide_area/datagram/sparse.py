"""A few of the samples that cross as datagrams cross over TCP as well, all the time.

A reader that finds out that UDP is blocked and then asks for the samples over TCP has the first of them a round trip
later, or three where its request is lost. So a few are on their way always, one in `CALM_NS` of each topic, and a
reader takes them from `WANTED_NS` after the newest datagram on. While the reader has no datagrams they come as often as
the line allows: on a line that is narrow, or that loses packets far away, they are all that TCP can carry.

They go over two connections by turns. What follows a packet that is lost waits in its connection until that was sent
again, and for as long again where that is lost as well; the other connection knows nothing of it.

TCP with losses carries no more than 1.22 MSS / (RTT sqrt(p)) (Mathis, Semke, Mahdavi and Ott, "The macroscopic behavior
of the TCP congestion avoidance algorithm", Computer Communication Review 27(3), 1997, with sqrt(3/2)).
"""

from collections.abc import Sequence
from math import sqrt

# A few samples are also sent under their topic with one of these before it, by turns, and a reader has a connection for
# each.
SPARSE = (b"sparse/", b"sparse2/")
# the frames of a message and when it was received [ns]
Taken = tuple[Sequence[bytes], int]
# A reader takes a sample over TCP when no datagram has come for this time. With two pauses, for one connection while
# the other waits, that is within a deadline of 50 ms.
WANTED_NS = 20_000_000
CALM_NS = 12_000_000
# The calm samples take this share of a line that is known to be narrow.
_CALM_SHARE = 0.05
# The calm samples are no further apart than this.
_FURTHEST_NS = 100_000_000
# Where a reader has no datagrams, the samples take this share of what TCP carries.
_SHARE = 0.3
# Those samples are no closer to one another than this.
_CLOSEST_NS = 2_000_000
# What a message takes on the line beside its bytes: topic, CURVE, the headers of TCP and IPv6, and the answer to it.
_BESIDE_BYTES = 250
_STATUS = "law/status"
# A report of the law is a tenth of the samples at most [ns].
_STATUS_NS = 100_000_000
_MSS_BITS = 8 * 1400.0
_MATHIS = sqrt(1.5)


def carried_by_tcp(capacity_bit_per_s: int, loss_share: float, round_trip_s: float) -> float:
    """Return what TCP carries over a line [bit/s], infinite where nothing is known to limit it.

    Args:
        capacity_bit_per_s: What the line carries [bit/s], 0 where that is not known.
        loss_share: The share of its packets that it loses.
        round_trip_s: Its round trip [s], 0 where that is not known.
    """
    capacity = float(capacity_bit_per_s) or float("inf")
    if loss_share <= 0.0 or round_trip_s <= 0.0:
        return capacity
    return min(capacity, _MATHIS * _MSS_BITS / (round_trip_s * sqrt(loss_share)))


class SparseSamples:
    """Which of the samples of one end are sent over TCP as well."""

    def __init__(self) -> None:
        # What TCP carries from here [bit/s], and whether the other end has no datagrams.
        self.carried = float("inf")
        self.alone = False
        self._next_ns: dict[str, int] = {}
        self._turns: dict[str, int] = {}

    def takes(self, topic: str, size_bytes: int, now_ns: int) -> bytes | None:
        """Return by which of SPARSE a sample of a size [bytes] goes over TCP as well at a time [ns], None for most."""
        if now_ns < self._next_ns.get(topic, 0):
            return None
        needs_ns = 8e9 * (size_bytes + _BESIDE_BYTES) / self.carried
        if self.alone:
            pause_ns = min(max(needs_ns / _SHARE, _CLOSEST_NS), CALM_NS)
        else:
            pause_ns = min(max(needs_ns / _CALM_SHARE, CALM_NS), _FURTHEST_NS)
        self._next_ns[topic] = now_ns + max(round(pause_ns), _STATUS_NS if topic == _STATUS else 0)
        self._turns[topic] = turn = (self._turns.get(topic, 0) + 1) % len(SPARSE)
        return SPARSE[turn]

"""Sparse samples: a few of the samples that cross as datagrams also cross over TCP, all the time.

A reader that finds UDP blocked and then subscribes over TCP gets the first sample a round trip later, or three if its
request is lost. So a few samples are always in transit, one each `CALM_NS` of each topic, and a reader uses them once
the newest datagram is older than `WANTED_NS`. While the reader has no datagrams, they are sent as often as the line
allows: on a line that is narrow, or that loses packets far away, TCP can carry no more.

They use two connections in turn. Data behind a lost packet waits in its connection until the packet was sent again, and
for as long again if that is lost as well; the other connection is not affected.

TCP with losses carries at most 1.22 MSS / (RTT sqrt(p)) (Mathis, Semke, Mahdavi and Ott, "The macroscopic behavior of
the TCP congestion avoidance algorithm", Computer Communication Review 27(3), 1997, with sqrt(3/2)).
"""

from collections.abc import Sequence
from math import sqrt

# A few samples are also sent under their topic with one of these prefixes, in turn; a reader has a connection for each.
SPARSE = (b"sparse/", b"sparse2/")
# The frames of a message and the time at which it was received [ns].
Taken = tuple[Sequence[bytes], int]
# A reader uses a sample over TCP if no datagram has arrived for this time [ns]. With two pauses, for one connection
# while the other one waits, that is within a deadline of 50 ms.
WANTED_NS = 20_000_000
CALM_NS = 12_000_000
# While datagrams arrive, sparse samples take this share of a line that is known to be narrow.
_CALM_SHARE = 0.05
# They are then no further apart than this [ns].
_FURTHEST_NS = 100_000_000
# If a reader has no datagrams, sparse samples take this share of the capacity of TCP.
_SHARE = 0.3
# They are then no closer together than this [ns].
_CLOSEST_NS = 2_000_000
# The bytes that a message takes on the line besides its own: topic, CURVE, headers of TCP and IPv6, and the
# acknowledgement.
_BESIDE_BYTES = 250
_STATUS = "law/status"
# Reports of the law are no closer together than this: a tenth of the samples at most [ns].
_STATUS_NS = 100_000_000
_MSS_BITS = 8 * 1400.0
_MATHIS = sqrt(1.5)


def carried_by_tcp(capacity_bit_per_s: int, loss_share: float, round_trip_s: float) -> float:
    """Return the rate that TCP can carry over a line [bit/s], infinite if no limit is known.

    Args:
        capacity_bit_per_s: The capacity of the line [bit/s], 0 if unknown.
        loss_share: The share of packets that the line loses.
        round_trip_s: The round trip [s], 0 if unknown.
    """
    capacity = float(capacity_bit_per_s) or float("inf")
    if loss_share <= 0.0 or round_trip_s <= 0.0:
        return capacity
    return min(capacity, _MATHIS * _MSS_BITS / (round_trip_s * sqrt(loss_share)))


class SparseSamples:
    """Selects the samples of one end that are sent over TCP as well."""

    def __init__(self) -> None:
        # The rate that TCP carries from here [bit/s], and whether the other end has no datagrams.
        self.carried = float("inf")
        self.alone = False
        self._next_ns: dict[str, int] = {}
        self._turns: dict[str, int] = {}

    def takes(self, topic: str, size_bytes: int, now_ns: int) -> bytes | None:
        """Return the prefix from SPARSE under which a sample is also sent over TCP at now_ns [ns]; None for most."""
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

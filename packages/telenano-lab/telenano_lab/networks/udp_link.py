"""The carrier of the link for datagrams of any program: bounds of the datagrams in transit, and counts of their fates.

The fate of each datagram is in `link/fates`, with the topic `udp`.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple, Protocol, TypeVar

from telenano_lab.networks.byte_link import ByteLinkProcess
from telenano_lab.networks.network_trace import DIRECTIONS, Direction

# The steps in which delays and lateness are counted.
DELAY_STEP_NS = 100_000
LATE_STEP_NS = 10_000
# The greatest lateness that is counted, in steps.
_MOST_LATE = 100_000
_Key = TypeVar("_Key")


class Ports(Protocol):
    """The sockets with which the link sends, and from which datagrams come."""

    take: Callable[[Direction, bytes, str], None]

    def send(self, direction: Direction, payload: bytes, name: str) -> None:
        """Send a datagram of the named client in a direction."""


class Bounds(NamedTuple):
    """The most datagrams, and bytes, in transit in each direction."""

    datagrams: int = 20_000
    size_bytes: int = 64 << 20


_BOUNDS = Bounds()


class Counts:
    """Counts of the datagrams of one direction.

    delays and late: the number of datagrams by delay, and by lateness after their release, in whole steps.
    """

    def __init__(self) -> None:
        self.arrived = self.sent = self.overflow = 0
        self.on_way = self.on_way_bytes = 0
        self.dropped: dict[str, int] = {}
        self.delays: dict[int, int] = {}
        self.late: dict[int, int] = {}

    def summary(self) -> dict[str, object]:
        """Return the counts, and quantiles of the link's delays and of the additional lateness [ms]."""
        return {
            "arrived": self.arrived,
            "sent": self.sent,
            "dropped": dict(self.dropped),
            "over_the_bound": self.overflow,
            "left": self.on_way,
            "delay_ms": quantiles_ms(self.delays, DELAY_STEP_NS),
            "late_ms": quantiles_ms(self.late, LATE_STEP_NS),
        }


def quantiles_ms(counts: Mapping[int, int], step_ns: int) -> dict[str, float] | None:
    """Return median, 99 %, 99.9 % and maximum of values that were counted in whole steps [ms]; None without any."""
    total = sum(counts.values())
    if not total:
        return None
    quantiles: dict[str, float] = {}
    for name, share in (("p50", 0.5), ("p99", 0.99), ("p999", 0.999), ("max", 1.0)):
        wanted, seen = share * total, 0
        for step in sorted(counts):
            seen += counts[step]
            if seen >= wanted:
                quantiles[name] = round(step * step_ns * 1e-6, 3)
                break
    return quantiles


class UdpLink:
    """Sends datagrams on when the link releases them; datagrams beyond its bounds are dropped and counted."""

    topic = "udp"

    def __init__(self, link: ByteLinkProcess, ports: Ports, bounds: Bounds = _BOUNDS) -> None:
        """Begin with nothing in transit.

        Args:
            link: The link that the datagrams cross.
            ports: The sockets to which and from which datagrams are sent.
            bounds: The most datagrams and bytes in transit in each direction.
        """
        self._link, self._ports, self._bounds = link, ports, bounds
        self.counts: dict[Direction, Counts] = {way: Counts() for way in DIRECTIONS}
        self._overflow_reported_ns = 0
        ports.take = self.arrive

    def arrive(self, direction: Direction, payload: bytes, client: str) -> None:
        """Accept a datagram that has arrived, and send the datagrams that are due."""
        counts = self.counts[direction]
        counts.arrived += 1
        size = len(payload)
        if counts.on_way >= self._bounds.datagrams or counts.on_way_bytes + size > self._bounds.size_bytes:
            counts.overflow += 1
            self._tell_overflow(direction)
            return
        counts.on_way += 1
        counts.on_way_bytes += size
        self._link.arrive(direction, payload, client)

    def summary(self) -> dict[str, object]:
        """Return the counts by direction."""
        return {way: self.counts[way].summary() for way in DIRECTIONS}

    def send(
        self, direction: Direction, payload: bytes, client: str, *, delay_ns: int, late_ns: int, is_copy: bool
    ) -> None:
        """Send a datagram that the link has released, and count it."""
        self._ports.send(direction, payload, client)
        counts = self.counts[direction]
        counts.sent += 1
        _add(counts.delays, delay_ns // DELAY_STEP_NS)
        _add(counts.late, min(late_ns // LATE_STEP_NS, _MOST_LATE))
        self._leave(counts, len(payload), is_copy=is_copy)

    def dropped(self, direction: Direction, cause: str, size_bytes: int, *, is_copy: bool) -> None:
        """Count a datagram that the link has dropped."""
        counts = self.counts[direction]
        _add(counts.dropped, cause)
        self._leave(counts, size_bytes, is_copy=is_copy)

    @staticmethod
    def _leave(counts: Counts, size_bytes: int, *, is_copy: bool) -> None:
        # A copy does not count as in transit.
        if not is_copy:
            counts.on_way -= 1
            counts.on_way_bytes -= size_bytes

    def _tell_overflow(self, direction: Direction) -> None:
        now_ns = self._link.clock.monotonic_ns()
        if now_ns < self._overflow_reported_ns:
            return
        self._overflow_reported_ns = now_ns + 1_000_000_000
        bounds = self._bounds
        text = (
            f"{bounds.datagrams} datagrams or {bounds.size_bytes >> 20} MiB are in transit {direction}: those that"
            " arrive now are dropped"
        )
        self._link.event("link", "warning", text, over_the_bound=float(self.counts[direction].overflow))


def _add(counts: dict[_Key, int], what: _Key) -> None:
    counts[what] = counts.get(what, 0) + 1

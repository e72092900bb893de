"""The link for datagrams of any program: the node of the link, with UDP sockets in the place of the sites.

It has the name, the reports and the commands of a rig's link, so that whatever shows, changes or records a link does so
with this one. The truth of each datagram is `link/fates`, with the topic `udp`.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

from telenano.link import Direction, Fate, LinkSettings, Release
from telenano.runtime import DelayNode, DirectionPath, NodeContext, SiteEndpoint
from telenano.timing import NEVER_NS
from telenano.wire import Received, SessionControl

TOPIC = "udp"
WAYS: tuple[Direction, Direction] = ("forward", "backward")
# steps of the counts of delays and of lateness [ns]
DELAY_STEP_NS, LATE_STEP_NS = 100_000, 10_000
_MOST_LATE = 100_000
_FATES_AT_ONCE = 32
_Key = TypeVar("_Key")


class Ports(Protocol):
    """What the link sends with."""

    take: Callable[[Direction, bytes, str], None]

    def send(self, direction: Direction, payload: bytes, name: str) -> None:
        """Send a datagram in a direction, of the client of a name."""


class Bounds(NamedTuple):
    """How much may be in transit in each direction, in datagrams and in bytes."""

    datagrams: int = 20_000
    size_bytes: int = 64 << 20


_BOUNDS = Bounds()


class Counts:
    """What became of the datagrams of one direction.

    delays and late: how many had a delay, and how many were sent this long after their release, by whole steps.
    """

    def __init__(self) -> None:
        self.arrived = self.sent = self.overflow = 0
        self.on_way = self.on_way_bytes = 0
        self.dropped: dict[str, int] = {}
        self.delays: dict[int, int] = {}
        self.late: dict[int, int] = {}

    def summary(self) -> dict[str, object]:
        """Return the counts, and quantiles of the delays of the link and of what came on top of them [ms]."""
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
    """Return median, 99 %, 99.9 % and the greatest of values that were counted in whole steps [ms]."""
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


class UdpLink(DelayNode):
    """Sends datagrams on when the engine releases them; those beyond its bounds are dropped and counted."""

    # A re-run would need the datagrams, which no recording holds.
    journalled = False

    def __init__(
        self,
        context: NodeContext,
        settings: LinkSettings,
        outlets: tuple[SiteEndpoint, SiteEndpoint],
        ports: Ports,
        folder: Path = Path(),
        bounds: Bounds = _BOUNDS,
        duration_s: float | None = None,
    ) -> None:
        """Start with the settings.

        Args:
            context: The context of the node.
            settings: The settings of the link.
            outlets: The publishers at the slave and at the master.
            ports: What datagrams are sent with, and come from.
            folder: The folder in which the files of the settings are sought.
            bounds: How much may be in transit in each direction.
            duration_s: After this time the link ends [s]; None: at a signal.

        Raises:
            ConfigError: A file of the settings cannot be used.
        """
        super().__init__(context, settings, *outlets, folder)
        self._ports, self._bounds = ports, bounds
        self._numbers = dict.fromkeys(WAYS, 0)
        self.counts: dict[Direction, Counts] = {way: Counts() for way in WAYS}
        self._overflow_reported_ns = 0
        now_ns = self.clock.monotonic_ns()
        self._end_ns = NEVER_NS if duration_s is None else now_ns + round(duration_s * 1e9)
        ports.take = self.arrive

    def arrive(self, direction: Direction, payload: bytes, client: str) -> None:
        """Take a datagram that has arrived, and send what is due."""
        way, counts = self._ways[WAYS.index(direction)], self.counts[direction]
        counts.arrived += 1
        size = len(payload)
        if counts.on_way >= self._bounds.datagrams or counts.on_way_bytes + size > self._bounds.size_bytes:
            counts.overflow += 1
            self._tell_overflow(direction)
            return
        counts.on_way += 1
        counts.on_way_bytes += size
        number = self._numbers[direction]
        self._numbers[direction] += 1
        self.steps += 1
        self._send(way, way.engine.submit(self.clock.now_ns(), TOPIC, payload, number, client))
        # Small reports hold up the next datagram for less than one of a tenth of a second would.
        self._unreported += 1
        if self._unreported >= _FATES_AT_ONCE:
            for task in self._fates:
                self.defer(task)

    def on_message(self, received: Received) -> None:
        """Take note of the start of a session, which is all that a link for datagrams has of one."""
        self.begin_turn(received.received_ns - self.clock.epoch_offset_ns)
        message = received.message
        if type(message) is SessionControl and message.command == "start":
            self.engine.begin_session(received.received_ns)

    def deadline_ns(self) -> int:
        return min(super().deadline_ns(), self._end_ns)

    def on_deadline(self, now_ns: int) -> None:
        super().on_deadline(now_ns)
        if now_ns >= self._end_ns:
            self.context.request_stop()

    def make_safe(self) -> None:
        """Report the fates that are not reported yet; what is still in transit stays unsent."""
        self._publish_status()
        for way in self._ways:
            self._publish_fates(way)

    def summary(self) -> dict[str, object]:
        """Return the counts by direction."""
        return {way: self.counts[way].summary() for way in WAYS}

    def _send(self, way: DirectionPath, releases: Sequence[Release]) -> None:
        for release in releases:
            fate = release.fate
            self._ports.send(way.name, release.payload, fate.src)
            counts = self.counts[way.name]
            counts.sent += 1
            _add(counts.delays, fate.delay_ns // DELAY_STEP_NS)
            _add(counts.late, min((self.clock.now_ns() - (fate.release_ns or 0)) // LATE_STEP_NS, _MOST_LATE))
            if fate.copy == 0:
                counts.on_way -= 1
                counts.on_way_bytes -= fate.size_bytes

    def _take_fates(self, way: DirectionPath) -> list[Fate]:
        counts, fates = self.counts[way.name], super()._take_fates(way)
        for fate in fates:
            if fate.dropped:
                _add(counts.dropped, fate.dropped)
                if fate.copy == 0:
                    counts.on_way -= 1
                    counts.on_way_bytes -= fate.size_bytes
        return fates

    def _tell_overflow(self, direction: Direction) -> None:
        now_ns = self.clock.monotonic_ns()
        if now_ns < self._overflow_reported_ns:
            return
        self._overflow_reported_ns = now_ns + 1_000_000_000
        bounds = self._bounds
        text = (
            f"{bounds.datagrams} datagrams or {bounds.size_bytes >> 20} MiB are on their way {direction}: those that"
            " arrive now are dropped"
        )
        self.event("link", "warning", text, over_the_bound=float(self.counts[direction].overflow))


def _add(counts: dict[_Key, int], what: _Key) -> None:
    counts[what] = counts.get(what, 0) + 1

"""Check whether the line between two sites can carry a session, by the capacities measured at the start."""

from collections.abc import Callable

from telenano.wire import LinkNetwork, Message

# The rate of the loop in each direction at 1 kHz, with room for commands and reports [bit/s].
FULL_BIT_PER_S = 2_000_000
# The least capacity for a session: a node's report of 3 kB over TCP takes 50 ms of such a line, and a sample behind it
# misses its deadline [bit/s].
LEAST_BIT_PER_S = 500_000
# Trains are waited for until this time after everything else is ready [ns].
_PATIENCE_NS = 3_000_000_000
# A narrow line is observed for this time, because other traffic at the start makes it seem narrow [ns].
_DOUBT_NS = 10_000_000_000
# A direction has recovered when its rate is this share of the capacity.
_RECOVERED = 0.7
_WAYS = {"forward": "from the master to the slave", "backward": "from the slave to the master"}


class LineCheck:
    """The capacity of each direction [bit/s], as far as it is known, and the check of it."""

    def __init__(self, monotonic_ns: Callable[[], int]) -> None:
        self._monotonic_ns = monotonic_ns
        self._capacity: dict[str, int] = {}
        self._limit: dict[str, int | None] = {}
        # The times since which everything else is ready, and since which the line seems too narrow.
        self._since_ns: int | None = None
        self._narrow_ns: int | None = None
        # Without a report the link has no datagrams and measures nothing.
        self._reported = False

    def record(self, message: Message) -> None:
        """Record the capacity and the limit in a report of the network; other messages are ignored."""
        if isinstance(message, LinkNetwork):
            self._reported = True
            if message.capacity_bit_per_s is not None:
                self._capacity[message.direction] = message.capacity_bit_per_s
            # An end reports the direction that it receives, and the limit of the other direction, in which it sends.
            self._limit["backward" if message.direction == "forward" else "forward"] = (
                None if message.line == "free" else message.limit_bit_per_s
            )

    def settled(self) -> bool:
        """Return whether both directions are known, or nothing more will be; the first call begins the wait."""
        now = self._monotonic_ns()
        if self._since_ns is None:
            self._since_ns = now
        waited_ns = now - self._since_ns
        if self._refusal():
            return False
        if self._recovers():
            return waited_ns >= _DOUBT_NS
        is_measured = len(self._capacity) == len(_WAYS) and not self.advice()
        return not self._reported or is_measured or waited_ns >= _PATIENCE_NS

    def _recovers(self) -> bool:
        """Return whether a direction sends less than the line carries, because the start's connections filled it."""
        return any(
            limit is not None and limit < _RECOVERED * min(self._capacity.get(way, 0), FULL_BIT_PER_S)
            for way, limit in self._limit.items()
        )

    def refusal(self) -> str:
        """Return why no session is possible, with the numbers; empty if one is, or while that is in doubt."""
        now, text = self._monotonic_ns(), self._refusal()
        if not text:
            self._narrow_ns = None
        elif self._narrow_ns is None:
            self._narrow_ns = now
        elif now - self._narrow_ns >= _DOUBT_NS:
            return text
        return ""

    def _refusal(self) -> str:
        narrow = self._narrower_than(LEAST_BIT_PER_S)
        if not narrow:
            return ""
        worst_ms = 3e3 * 8e3 / max(1, min(self._capacity.values()))
        return (
            f"{narrow}, and a session needs {LEAST_BIT_PER_S * 1e-6:g} Mbit/s each way: a report of 3 kB takes "
            f"{worst_ms:.0f} ms of it, and a sample that waits behind one is past its deadline of 50 ms"
        )

    def advice(self) -> list[str]:
        """Return sentences on how a narrow line affects a session; none if the line is wide enough."""
        narrow = self._narrower_than(FULL_BIT_PER_S)
        if not narrow:
            return []
        return [
            f"{narrow}, and the loop at 1 kHz needs {FULL_BIT_PER_S * 1e-6:g} Mbit/s each way: samples that would "
            "queue are left out; `telenano link show` says how many"
        ]

    def _narrower_than(self, bit_per_s: int) -> str:
        carried = [
            f"the line {_WAYS[way]} carries {carries * 1e-6:.2g} Mbit/s"
            for way, carries in sorted(self._capacity.items(), reverse=True)
            if carries < bit_per_s
        ]
        return " and ".join(carried)

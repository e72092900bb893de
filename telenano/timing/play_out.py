"""A play-out buffer, which turns the varying delay of samples into a nearly constant one.

Each sample is held until its send time plus a target. The target follows a high quantile of the delays: it rises by a
step for each sample that is too late for it, and falls by a small part of that for each other one, so that in the long
run one in a hundred is too late (a stochastic approximation of the quantile, Robbins and Monro 1951). Send times are by
the sender's clock: an offset is part of every delay, and cancels.

A law that needs a constant delay, such as wave variables, benefits; the cost is that every sample gets nearly as old as
the slowest ones. The node and the studies share this code.
"""

# Rise of the target for each sample with a longer delay.
_UP_NS = 49_500
# Fall of the target for each other sample: 1/99 of the rise, so that one sample of a hundred is too late.
_DOWN_NS = 500
# Greatest target above the least delay [ns], because readers reject samples older than their deadline.
_MOST_NS = 40_000_000
# Rise of the least delay for each sample [ns], which exceeds the drift of clocks and follows changes of the route.
_RECOVERY_NS = 1_000


class PlayOut:
    """Play-out buffer of one direction."""

    def __init__(self) -> None:
        self._least_ns: int | None = None
        self._target_ns = 0

    def release_ns(self, sent_ns: int, arrived_ns: int) -> int:
        """Return the release time of a sample by the receiver's clock [ns], not before its arrival.

        `sent_ns` is by the sender's clock, `arrived_ns` by the receiver's.
        """
        delay_ns = arrived_ns - sent_ns
        if self._least_ns is None:
            self._least_ns = self._target_ns = delay_ns
        self._least_ns = min(delay_ns, self._least_ns + _RECOVERY_NS)
        self._target_ns += _UP_NS if delay_ns > self._target_ns else -_DOWN_NS
        self._target_ns = min(max(self._target_ns, self._least_ns), self._least_ns + _MOST_NS)
        return max(arrived_ns, sent_ns + self._target_ns)

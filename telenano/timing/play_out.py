"""A play-out buffer: what arrives after varying delays is handed on after one that hardly varies.

Each sample is held until its time of sending plus a target. The target follows a high quantile of the delays: it rises
by a step for each sample that comes too late for it, and falls by a small part of that for each that is in time, so
that in the long run a hundredth comes too late (a stochastic approximation of the quantile,
Robbins and Monro 1951). Times of sending are on the sender's clock: an offset is part of every delay, and cancels.

A law that wants a constant delay, such as wave variables, gains what jitter costs it; every sample is older by what the
slowest take longer. The node and the studies use this very code.
"""

# The target rises by this with each sample that is later than it.
_UP_NS = 49_500
# The target falls by this with each other sample: so much less that one sample of a hundred comes too late.
_DOWN_NS = 500
# A sample is held back by no more beyond the least delay [ns]; readers reject what is older than their deadline.
_MOST_NS = 40_000_000
# The least delay may rise by so much with each sample: clocks drift by less, and routes change.
_RECOVERY_NS = 1_000


class PlayOut:
    """The buffer of one direction."""

    def __init__(self) -> None:
        self._least_ns: int | None = None
        self._target_ns = 0

    def release_ns(self, sent_ns: int, arrived_ns: int) -> int:
        """Return when to hand on a sample, not before it arrived; both times by their own clocks [ns]."""
        delay_ns = arrived_ns - sent_ns
        if self._least_ns is None:
            self._least_ns = self._target_ns = delay_ns
        self._least_ns = min(delay_ns, self._least_ns + _RECOVERY_NS)
        self._target_ns += _UP_NS if delay_ns > self._target_ns else -_DOWN_NS
        self._target_ns = min(max(self._target_ns, self._least_ns), self._least_ns + _MOST_NS)
        return max(arrived_ns, sent_ns + self._target_ns)

"""A play-out buffer: samples wait until their time, so that all have the same delay."""

import heapq
import itertools
from collections.abc import Iterable

from telenano.timing import NEVER_NS, PlayOut


class HeldSamples:
    """The samples of a play-out buffer, the earliest first.

    Call `held.hold(sent_ns, now_ns, offset_ns, samples)` for each datagram, and `held.released(monotonic_ns)` at
    `due_ns`.
    """

    def __init__(self) -> None:
        self._play_out = PlayOut()
        self._waiting: list[tuple[int, int, list[bytes]]] = []
        self._order = itertools.count()

    @property
    def due_ns(self) -> int:
        """The time at which the next sample is due, on the monotonic clock [ns]."""
        return self._waiting[0][0] if self._waiting else NEVER_NS

    def hold(self, sent_ns: int, now_ns: int, epoch_offset_ns: int, samples: Iterable[list[bytes]]) -> None:
        """Keep the samples of a datagram until their time.

        Args:
            sent_ns: The time at which it was sent, on the clock of the other end [ns].
            now_ns: The time now on the clock of this end [ns].
            epoch_offset_ns: The lead of this clock over the monotonic one [ns].
            samples: The frames of each sample.
        """
        release_ns = self._play_out.release_ns(sent_ns, now_ns) - epoch_offset_ns
        for frames in samples:
            heapq.heappush(self._waiting, (release_ns, next(self._order), frames))

    def released(self, monotonic_ns: int) -> list[list[bytes]]:
        """Remove and return the samples whose time has come."""
        released = []
        while self._waiting and self._waiting[0][0] <= monotonic_ns:
            released.append(heapq.heappop(self._waiting)[2])
        return released

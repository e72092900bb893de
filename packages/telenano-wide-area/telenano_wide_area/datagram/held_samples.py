"""Samples that wait for their time, so that each of them is late by as much as the others."""

import heapq
import itertools
from collections.abc import Iterable

from telenano.timing import NEVER_NS, PlayOut


class HeldSamples:
    """The samples of a play-out buffer, the earliest first.

    `held.hold(sent_ns, now_ns, offset_ns, samples)` at each datagram, and `held.released(monotonic_ns)` when `due_ns`
    has come.
    """

    def __init__(self) -> None:
        self._play_out = PlayOut()
        self._waiting: list[tuple[int, int, list[bytes]]] = []
        self._order = itertools.count()

    @property
    def due_ns(self) -> int:
        """When the next sample is due, on the monotonic clock [ns]."""
        return self._waiting[0][0] if self._waiting else NEVER_NS

    def hold(self, sent_ns: int, now_ns: int, epoch_offset_ns: int, samples: Iterable[list[bytes]]) -> None:
        """Keep the samples of a datagram until their time.

        Args:
            sent_ns: When it was sent, on the clock of the other end [ns].
            now_ns: The time now on the clock of this end [ns].
            epoch_offset_ns: What this clock is ahead of the monotonic one [ns].
            samples: The frames of each sample.
        """
        release_ns = self._play_out.release_ns(sent_ns, now_ns) - epoch_offset_ns
        for frames in samples:
            heapq.heappush(self._waiting, (release_ns, next(self._order), frames))

    def released(self, monotonic_ns: int) -> list[list[bytes]]:
        """Return the samples whose time has come, and keep the others."""
        released = []
        while self._waiting and self._waiting[0][0] <= monotonic_ns:
            released.append(heapq.heappop(self._waiting)[2])
        return released

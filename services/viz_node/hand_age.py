"""Lateness of the frames of a page's hand, from time stamps of the page's own clock.

Page and server need no common clock: the transit time of a frame minus the least one of the last minute is the time
that the frame waited, in a queue before a line or on a busy machine.
"""

from collections import deque

# Length of the time spans for each of which the least transit time is stored [s].
_SPAN_S = 10.0
# Number of the spans.
_SPANS = 6
# Round trip of a question below which a page is not late, even if it seems so because its clock stood still while its
# machine slept [s].
_QUICK_S = 0.1
# Greatest age of the answer for that check [s].
_LATELY_S = 2.5
# Least apparent lateness for that check [s].
_STEPPED_S = 1.0


class HandAge:
    """Lateness of one page's hand: `number` of the newest frame used, `late_s`, lateness of the newest arrival [s]."""

    def __init__(self) -> None:
        self.number = 0
        self.late_s = 0.0
        # For each span its beginning, and the least difference between arrival and stamp [s].
        self._least: deque[tuple[float, float]] = deque(maxlen=_SPANS)

    def take(self, stamp_s: float, arrived_s: float, way: tuple[float, float] | None) -> float:
        """Record a frame and return its lateness [s].

        Args:
            stamp_s: The time of sending, by the page's clock [s].
            arrived_s: The time of arrival, by this machine's clock [s].
            way: Time and round trip of the newest answer of the page to a question [s]; None before the first.
        """
        took_s = arrived_s - stamp_s
        least_s = min((least_s for _, least_s in self._least), default=took_s)
        if way is not None and arrived_s - way[0] < _LATELY_S and way[1] < _QUICK_S and took_s - least_s > _STEPPED_S:
            self._least.clear()
        if not self._least or arrived_s - self._least[-1][0] >= _SPAN_S:
            self._least.append((arrived_s, took_s))
        elif took_s < self._least[-1][1]:
            self._least[-1] = (self._least[-1][0], took_s)
        while arrived_s - self._least[0][0] >= _SPANS * _SPAN_S:
            self._least.popleft()
        self.late_s = took_s - min(least_s for _, least_s in self._least)
        return self.late_s

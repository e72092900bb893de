"""How late the frames of a page's hand are, by the page's own clock.

Page and server have no common clock, and do not need one: what a frame took beyond the quickest of the last minute is
time that it waited, in a queue before a line or on a machine that is busy.
"""

from collections import deque

# The quickest frame is sought in the newest spans of this length.
_SPAN_S = 10.0
# The number of those spans.
_SPANS = 6
# A page whose clock stood still, as that of a machine that slept, seems late by that for ever. It is not late where a
# question went there and back within this time.
_QUICK_S = 0.1
# The question was asked at most this long ago.
_LATELY_S = 2.5
# The page seems late by more than this.
_STEPPED_S = 1.0


class HandAge:
    """The frames of one page's hand: `number` of the newest that was taken, `late_s` of the newest that came [s]."""

    def __init__(self) -> None:
        self.number = 0
        self.late_s = 0.0
        # The least of arrival less stamp in each span, with the time at which that began [s].
        self._least: deque[tuple[float, float]] = deque(maxlen=_SPANS)

    def take(self, stamp_s: float, arrived_s: float, way: tuple[float, float] | None) -> float:
        """Take a frame and return how late it is [s].

        Args:
            stamp_s: When it was sent, by the page's clock [s].
            arrived_s: When it arrived, by this machine's [s].
            way: When the newest question to the page was answered and how long that took [s]; None before the first.
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

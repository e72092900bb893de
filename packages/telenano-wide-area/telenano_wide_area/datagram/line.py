"""The standing queue of a line in each direction, from exchanges of four time stamps between two clocks that drift.

With the times t1 to t4 of `clock_offset`, the question seems to take f = t2 - t1 and the answer b = t4 - t3. Each
contains the offset of the clocks, which drifts: f rises as b falls. A queue can only add to f or b. So every f bounds
the offset from above and every -b from below, and the two lines that touch these bounds from inside, by which clocks
are compared (`telenano.timing.clock_fit`), are the delays of the empty line.

The delay of a datagram beyond these lines is queueing or jitter. Its least value within a tenth of a second is a
standing queue (Nichols and Jacobson, "Controlling queue delay", ACM Queue 10, 2012), because jitter comes and goes
within that time. Neither direction can have a queue longer than the excess of the round trip over its least value,
which no clock enters. A route that has become longer is no queue: the line is then fitted anew above the delays since
(`jump`).
"""

from collections import deque
from typing import NamedTuple

from telenano.timing import STEP_NS, ClockLine

# A queue stands if it lasts for two of these [ns].
_HALF_WINDOW_NS = 50_000_000
# The variation of the delay without queues is that of the calmest quarter of this number of half windows.
_VARIATIONS = 16
# A queue is told after this time [ns], in which a route that has become longer shows itself.
_SETTLED_NS = 400_000_000
# A half window counts if it had at least this number of delays.
_FEWEST_SEEN = 3
# The least delay represents a whole span; by the drift of usual clocks another one in it may be less [s/s].
_USUAL_DRIFT = 1e-4
_ROUNDED_NS = 50_000
# Time stamps are no more exact than the turns of a process [ns].
_STAMPED_NS = 500_000
# The number of spans of equal length for which least delays are kept. Older ones (ten minutes) are forgotten, because
# routes change.
_SPANS = 64
# The length of a span doubles from _FIRST_SPAN_NS to _LAST_SPAN_NS.
_FIRST_SPAN_NS = 250_000_000
_LAST_SPAN_NS = 16_000_000_000
# Older spans are forgotten only if there are at least this number.
_FEWEST_SPANS = 4
# After the clock of this process was set, datagrams in transit arrive within this multiple of the least round trip, and
# this time [ns].
_UNDER_WAY, _UNDER_WAY_NS = 2, 100_000_000
# A time [ns], and a delay at that time [ns].
Bound = tuple[int, int]


class Least(NamedTuple):
    """The least delays of one span with their times: there, back, and the round trip of one exchange [ns]."""

    there: Bound
    back: Bound
    both_ns: int

    def and_least(self, other: "Least") -> "Least":
        """Return the least of two spans."""
        there, back = min(self.there, other.there, key=_delay), min(self.back, other.back, key=_delay)
        return Least(there, back, min(self.both_ns, other.both_ns))


def _delay(point: Bound) -> int:
    return point[1]


class Standing(NamedTuple):
    """A standing queue [ns] and its interval [ns].

    A queue that has stood since the line began is not in the interval: nothing shows it, and it counts as part of the
    line.
    """

    queue_ns: int
    low_ns: int
    high_ns: int


class Line:
    """Both directions of a line; `there_ns` and `back_ns` are their standing queues [ns], None until they are known."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Begin again, because the other clock was set, or belongs to another process."""
        # The time up to which exchanges are left out because the clock of this process was set back, and its newest
        # time [ns].
        self._left_out_ns = self._received_ns = 0
        self._zero: tuple[int, int, int] | None = None
        self._spans: list[Least] = []
        self._span_ns = _FIRST_SPAN_NS
        self._now: Least | None = None
        self._now_ends_ns = 0
        # The spans of the route before it became longer.
        self._shorter: tuple[list[Least], int] | None = None
        self._slope = self._expected_slope = self._there = self._back = 0.0
        self._least_both = 0
        self._lowest = self._before = (0.0, 0.0)
        # Standing queues of the direction to here that are not settled yet: end of their half window, and length [ns].
        self._unsettled: deque[tuple[float, float]] = deque()
        self._told_back = 0.0
        self._highest, self._last, self._seen = (0.0, 0.0), 0.0, 0
        # The variation of the delay of each direction within the newest half windows.
        self._varied: deque[tuple[float, float]] = deque(maxlen=_VARIATIONS)
        self._window_ends_ns = 0.0
        self._windows = 0

    @property
    def drift(self) -> float:
        """The rate of the other clock relative to this one, minus 1."""
        return self._slope

    @property
    def there_ns(self) -> int | None:
        """The standing queue of the direction from here [ns]."""
        return self._standing(0)

    @property
    def back_ns(self) -> int | None:
        """The standing queue of the direction to here [ns]."""
        return self._standing(1)

    @property
    def ways(self) -> tuple[Standing | None, Standing | None]:
        """The standing queues of both directions, there and back, with their intervals."""
        there_ns, back_ns = self.there_ns, self.back_ns
        return (
            None if there_ns is None else self._within(0, there_ns),
            None if back_ns is None else self._within(1, back_ns),
        )

    def take_back(self) -> Standing | None:
        """Return the greatest standing queue of the direction to here that has settled since the last call.

        A route that has just become longer looks like a queue at first, so what stood is told `_SETTLED_NS` later.
        """
        most_ns, self._told_back = round(self._told_back), 0.0
        return None if self.back_ns is None else self._within(1, most_ns)

    @property
    def there_variation_ns(self) -> int:
        """The variation of the delay from here, in the calmest quarter of the last second [ns]."""
        return self._variation_ns(0)

    def _variation_ns(self, way: int) -> int:
        varied = sorted(both[way] for both in self._varied)
        return round(varied[len(varied) // 4]) if varied else 0

    def _within(self, way: int, queue_ns: int) -> Standing:
        """Return a queue with its interval: jitter is no queue, and the empty delay may be longer than fitted."""
        # No exchange has shown both directions empty at once, by this amount.
        unseen_ns = round(max(0.0, self._least_both - self._there - self._back))
        low_ns = max(0, queue_ns - unseen_ns - self._variation_ns(way) - _STAMPED_NS)
        return Standing(queue_ns, low_ns, queue_ns + unseen_ns + _STAMPED_NS)

    def _standing(self, way: int) -> int | None:
        return None if self._windows < 2 else round(min(self._before[way], self._lowest[way]))

    def record(self, sent_ns: int, there_ns: int, back_ns: int, received_ns: int) -> None:
        """Record the time stamps of an exchange: sent here, received there, answered there, received here [ns]."""
        went_back, self._received_ns = received_ns < self._received_ns, received_ns
        if received_ns < self._left_out_ns and not went_back:
            return
        there, back = there_ns - sent_ns, received_ns - back_ns
        if self._zero is None:
            self._zero = (received_ns, there, back)
        at, f, b = (x - zero for x, zero in zip((received_ns, there, back), self._zero, strict=True))
        if at < 0:
            # The clock of this process was set.
            self._forget_clock(received_ns, went_back=went_back)
            return
        f_above, b_above = f - self._slope * at, b + self._slope * at
        falls = max(self._there - f_above, self._back - b_above) > STEP_NS
        if self._shorter and (falls or f + b < self._least_both - STEP_NS):
            # The route is as short again as before, or always was.
            self._spans, self._span_ns = self._shorter
            self._shorter, self._now, self._now_ends_ns = None, None, 0
            self._fit()
        elif f + b < self._least_both - STEP_NS:
            # No round trip can be that much shorter than the shortest: the clock of this process was set.
            self._forget_clock(received_ns, went_back=went_back)
            return
        self._keep(Least((at, f), (at, b), f + b), at)
        f_above, b_above = f - self._slope * at, b + self._slope * at
        self._there, self._back = min(self._there, f_above), min(self._back, b_above)
        self._least_both = min(self._least_both, f + b)
        most = f + b - self._least_both
        self._see(at, min(f_above - self._there, most), min(b_above - self._back, most))

    def _forget_clock(self, received_ns: int, *, went_back: bool) -> None:
        """Begin again after the clock of this process was set, without datagrams in transit, which mix both times."""
        _, there, back = self._zero or (0, 0, 0)
        round_trip_ns = max(0, there + back + round(self._least_both))
        self.forget()
        if went_back:
            self._left_out_ns = received_ns + _UNDER_WAY * round_trip_ns + _UNDER_WAY_NS
            self._received_ns = received_ns

    def jump(self, at_ns: int, there_ns: int, back_ns: int) -> None:
        """Begin again from a route that has become longer by these times there and back [ns]."""
        if self._zero is None:
            return
        at = at_ns - self._zero[0]
        f, b = round(self._there + self._slope * at) + there_ns, round(self._back - self._slope * at) + back_ns
        self._spans, self._span_ns, self._now, self._now_ends_ns = (
            [Least((at, f), (at, b), f + b)],
            _FIRST_SPAN_NS,
            None,
            0,
        )
        # The rates of the clocks have not changed.
        self._expected_slope = self._slope
        self._there, self._back, self._least_both = f - self._slope * at, b + self._slope * at, f + b
        # This part of the standing delay was no queue.
        self._lowest, self._before = (
            (max(0.0, there - there_ns), max(0.0, back - back_ns)) for there, back in (self._lowest, self._before)
        )
        self._unsettled = deque((end, max(0.0, back - back_ns)) for end, back in self._unsettled)

    def _keep(self, least: Least, at: int) -> None:
        self._now = least if self._now is None else self._now.and_least(least)
        if at < self._now_ends_ns:
            return
        self._now_ends_ns = at + self._span_ns
        self._spans.append(self._now)
        self._now = None
        if len(self._spans) >= _SPANS and self._span_ns < _LAST_SPAN_NS:
            pairs = zip(self._spans[::2], self._spans[1::2], strict=True)
            self._spans, self._span_ns = [first.and_least(second) for first, second in pairs], 2 * self._span_ns
        del self._spans[:-_SPANS]
        self._fit()

    def _fit(self) -> None:
        """Fit the highest pair of lines below the kept delays.

        If it lies further below the shortest round trip than jitter explains, the other clock was set, or runs at
        another rate, since then: the older half of the spans is forgotten.
        """
        # Delays are relative to the first exchange. Its own delays are added for the fit, so that bounds without a line
        # between them mean that a clock was set.
        _, there_ns, back_ns = self._zero or (0, 0, 0)
        took_ns = there_ns + back_ns
        while True:
            self._least_both = min(span.both_ns for span in self._spans)
            line = ClockLine.through(
                [(at, delay + took_ns) for (at, delay), _, _ in self._spans],
                [(at, -delay) for _, (at, delay), _ in self._spans],
                self._expected_slope,
                took_ns + self._least_both + _USUAL_DRIFT * self._span_ns + _ROUNDED_NS,
            )
            self._slope = line.drift
            round_trip_ns = line.round_trip_ns - took_ns
            half, middle = 0.5 * round_trip_ns, line.at(0) - 0.5 * took_ns
            self._there, self._back = half + middle, half - middle
            if self._least_both - round_trip_ns <= STEP_NS:
                return
            if self._shorter:
                # The route that seemed longer is not: the older spans count again.
                self._spans, self._span_ns = [*self._shorter[0], self._spans[-1]], self._shorter[1]
                self._shorter = None
                continue
            if len(self._spans) < _FEWEST_SPANS:
                return
            del self._spans[: len(self._spans) // 2]

    def _see(self, at: float, there: float, back: float) -> None:
        if at >= self._window_ends_ns:
            self._window_ends_ns = at + _HALF_WINDOW_NS
            if self._seen >= _FEWEST_SEEN:
                self._varied.append((self._highest[0] - self._lowest[0], self._highest[1] - self._lowest[1]))
            if self._windows > 1:
                self._unsettled.append((at, min(self._before[1], self._lowest[1])))
            while self._unsettled and at - self._unsettled[0][0] >= _SETTLED_NS:
                self._told_back = max(self._told_back, self._unsettled.popleft()[1])
            self._before, self._lowest, self._highest = self._lowest, (there, back), (there, back)
            self._windows, self._seen = self._windows + 1, 1
        else:
            self._lowest = (min(self._lowest[0], there), min(self._lowest[1], back))
            self._highest = (max(self._highest[0], there), max(self._highest[1], back))
            self._seen += there != self._last
        self._last = there

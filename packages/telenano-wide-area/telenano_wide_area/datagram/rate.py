"""Rate control of an end over a line that may be full, after GCC, by a queue that grows with the load.

The structure is that of Google Congestion Control (Carlucci, De Cicco, Holmer and Mascolo, "Analysis and design of the
Google congestion control for WebRTC", MMSys 2016): while a queue stands, the rate becomes a share of the delivered
rate; otherwise it grows. GCC infers the queue from the gradient of the delay; here `line.Line` gives the standing
delay, so that the threshold is one of delay, as in LEDBAT (RFC 6817). Losses without a queue change nothing, because
they do not mean that a line is full.

A standing delay is not necessarily a queue of this end's making. On a line that keeps the order, datagrams wait for one
another, and if its delay jitters, some of that delay stands for as long as the line exists; a TCP transfer keeps its
own queue. So each reduction of the rate is a trial (`Trial`). A queue that this end makes drains at a known rate: if a
share r of the capacity is sent, by 1 - r of the elapsed time. If the delay still stands after two reductions, or falls
much faster than that, sending less is not what lowers it, and the previous rate is restored. The delay that stood is
then `excused`: the queue has to grow above it, or ten seconds have to pass, before another trial.

The control is stable, because a reduction that does not help lasts for two trials, of some 0.3 s and a round trip each,
so that reductions cannot add up: on a line without any limit they cost one or two samples in a hundred. Jitter may look
like a queue that drained as expected; the rate is then restored within seconds, because it grows whenever no queue
stands. If a queue of this end is taken for jitter, it grows beyond the excused delay within a fraction of a second.

If other traffic keeps a queue, sending less would only leave the line to it. So losses decide meanwhile, as they do in
GCC: if the loss exceeds that at the reduced rate by more than 10 %, the rate falls by half of the excess.
"""

from collections import deque
from collections.abc import Sequence
from typing import Literal, NamedTuple

# A standing delay from this on may be a queue [ns].
FULL_NS = 4_000_000
# A standing queue of this length is a fault to report [ns].
WARN_QUEUE_NS = 10_000_000
# The rate becomes this share of the delivered rate, so that the queue drains.
_SHARE = 0.85
# The share falls to this at the lowest.
_LEAST_SHARE = 0.5
# The share falls by this for each nanosecond of queue above FULL_NS.
_SHARE_PER_NS = 5e-9
# The factor by which the rate grows in a second, unless it is near the rate at which the line was last full.
_GROWTH = 1.5
# Near that rate, growth begins with this factor, slowly, as that of CUBIC (RFC 9438).
_CAREFUL_GROWTH = 1.03
# The factor rises by this for each second since the line was full.
_MORE_PER_S = 0.02
# The rate is near that at which the line was last full if it is between these shares of it.
_NEAR = 0.8
_PAST = 1.15
# After a round trip and this time, over which a queue is judged, the effect of a change shows [ns].
_JUDGED_NS = 150_000_000
# A trial is judged when its effect has had this time to show [ns].
_TRIED_NS = 250_000_000
# Measured values lag by up to this time [ns].
_LAG_NS = 100_000_000
# A queue of this end falls by at least this share of the data that was not sent since the reduction.
_TOO_LITTLE = 0.5
# It falls by no more than this multiple of that data plus _TOO_MUCH_NS.
_TOO_MUCH = 1.5
_TOO_MUCH_NS = 12_000_000
# A line was not full if it delivers this multiple of the rate at the trial while less is sent.
_MORE = 1.2
# The line carries the present rate if it delivers this share of it.
_CARRIED = 0.9
# After this number of reductions, the missing rest is lost for another reason than a queue.
_MOST_STEPS = 3
# A delay counts as a queue again if it exceeds this multiple of the excused delay plus _EXCUSED_NS.
_EXCUSED = 1.5
_EXCUSED_NS = 6_000_000
# A delay is excused for this time [ns].
_EXCUSED_FOR_NS = 10_000_000_000
# After this time without a standing delay, no delay is excused any more [ns].
_GONE_NS = 1_000_000_000
# This multiple of the delay's variation is not counted as a queue.
_VARIATION = 2
# From this variation on, a queue may seem to have drained by chance [ns].
_VARIES_NS = 14_000_000
# When a delay is excused, the rate becomes at most this multiple of the rate that was carried.
_RESTORED = 1.25
# The rate then grows by this factor at each check of the losses.
_EXCUSED_GROWTH = 1.05
# It grows until it is this multiple of the sent rate.
_UNREACHED = 1.5
# A queue that returns within this time of the start of a trial may continue that trial [ns].
_SOON_NS = 5_000_000_000
# It does so if the rate is less than this share of the rate that was carried before it.
_WELL_BELOW = 0.9
# Losses that exceed the excused ones by more than this share lower the rate.
_MUCH_LOST = 0.10
# The shortest interval between checks of the losses [ns].
_LOSS_PERIOD_NS = 500_000_000
# A full queue loses more than this share, and at least this number of datagrams, over the span of the delivery.
_FULL_LOSES, _FEWEST_LOST = 0.08, 6
# A queue that a sender keeps full, with little more than the line carries, loses this share over the longer span [ns].
_KEPT_FULL_LOSES, _LONG_SPAN_NS, _LONG_STEP_NS = 0.02, 1_500_000_000, 50_000_000
# The span over which the delivered rate is judged [ns].
_SPAN_NS = 300_000_000

Mode = Literal["free", "full", "shared"]


class PathEstimate(NamedTuple):
    """The state of the direction in which an end sends, as the end sees it.

    queue_ns: the standing delay [ns]; delivered_bytes_per_s: the recent rate of arrivals; loss_share: the share lost of
    the recently sent datagrams; round_trip_ns: [ns]; variation_ns: the least variation of the delay within the time
    over which it is judged [ns].
    """

    queue_ns: int
    delivered_bytes_per_s: float
    loss_share: float
    round_trip_ns: int
    variation_ns: int = 0


class Trial(NamedTuple):
    """Reductions of the rate that test whether the queue drains.

    `first_ns` is the time of the first, `begin_ns` that of the last of `steps`, and `queue_ns` the queue then.
    `before_bytes_per_s` is the rate before the first, and `carried_bytes_per_s` the delivered rate at the last.
    """

    first_ns: int
    begin_ns: int
    queue_ns: int
    before_bytes_per_s: float
    carried_bytes_per_s: float
    steps: int


class Delivery:
    """The rate at which datagrams are delivered, from the other end's reports.

    The other end's clock times both ends of a span, so that neither the offset of the clocks nor the delay of the
    report matters. The delivered rate is limited by the sent rate, whatever the other end reports.
    """

    def __init__(self) -> None:
        self._marks: deque[tuple[int, int, int]] = deque()
        # The same over the longer span, in steps.
        self._long_marks: deque[tuple[int, int, int]] = deque()

    def record(self, heard_ns: int, expected: int, arrived: int) -> None:
        """Record that `arrived` of `expected` datagrams were there when the newest came, at heard_ns on its clock."""
        if self._marks and (expected < self._marks[-1][1] or heard_ns < self._marks[-1][0] - _SPAN_NS):
            # The other end or its clock has changed.
            self._marks.clear()
            self._long_marks.clear()
        if not self._marks or heard_ns > self._marks[-1][0]:
            self._marks.append((heard_ns, expected, arrived))
        while len(self._marks) > 2 and heard_ns - self._marks[1][0] >= _SPAN_NS:
            self._marks.popleft()
        if not self._long_marks or heard_ns - self._long_marks[-1][0] >= _LONG_STEP_NS:
            self._long_marks.append((heard_ns, expected, arrived))
        while heard_ns - self._long_marks[0][0] > _LONG_SPAN_NS:
            self._long_marks.popleft()

    def rate(self, bytes_each: float, sent_bytes_per_s: float) -> tuple[float, float] | None:
        """Return the delivered rate [bytes/s] and the share lost; None before there is a span.

        Args:
            bytes_each: The mean size of a sent datagram [bytes].
            sent_bytes_per_s: The recent rate of sending [bytes/s].
        """
        if len(self._marks) < 2 or self._marks[-1][0] - self._marks[0][0] < _SPAN_NS // 2:
            return None
        (first_ns, expected, arrived), (last_ns, *last) = self._marks[0], self._marks[-1]
        came, sent = max(0, last[1] - arrived), last[0] - expected
        delivered = came * bytes_each / ((last_ns - first_ns) * 1e-9)
        return min(delivered, 1.5 * sent_bytes_per_s), min(1.0, max(0.0, 1.0 - came / sent)) if sent else 0.0

    def is_of_full_queue(self) -> bool:
        """Return whether the recent losses show that a longer delay is that of a full queue.

        A queue that drops datagrams for lack of room keeps one delay while it is full, like a route, but a route that
        has become longer loses no more than before.
        """
        return _loses(self._marks, _FULL_LOSES)

    def is_kept_full(self) -> bool:
        """Return whether a delay that grew gradually, while less was sent on purpose, is that of a queue.

        A sender keeps a queue that it has found full nearly full, so that little is lost at any moment.
        """
        return _loses(self._long_marks, _KEPT_FULL_LOSES)


def _loses(marks: Sequence[tuple[int, int, int]], share: float) -> bool:
    """Return whether more than a share, and at least a few datagrams, were lost between the first and last mark."""
    if len(marks) < 2:
        return False
    (_, expected, arrived), (_, *last) = marks[0], marks[-1]
    sent = last[0] - expected
    lost = sent - max(0, last[1] - arrived)
    return lost >= _FEWEST_LOST and lost > share * sent


class RateControl:
    """The rate of one end; `bytes_per_s` is the most that it may send.

    `mode`: free, only the budget limits the rate; full, a queue stood and the rate follows the delivered rate; shared,
    sending less does not lower the delay, and losses decide. `carried_bytes_per_s` is the rate that was delivered last
    while a queue stood, 0 before that.
    """

    def __init__(self, most_bytes_per_s: float) -> None:
        self.bytes_per_s = self.most_bytes_per_s = most_bytes_per_s
        self.carried_bytes_per_s = 0.0
        self.mode: Mode = "free"
        self._ready_ns = self._stood_ns = 0
        self._at_ns: int | None = None
        self._full_at: tuple[float, int] | None = None
        # The present trial, and the last one whose queue drained.
        self._trial: Trial | None = None
        self._last: Trial | None = None
        # The excused delay, the time until which it is excused [ns], and the share that was lost when it was excused.
        self._excused_ns, self._excused_until_ns, self._lost_anyway = 0, 0, 0.0

    def update(self, now_ns: int, seen: PathEstimate, least_bytes_per_s: float) -> None:
        """Update the rate by an estimate of the line, some twenty times a second; the least rate is always allowed."""
        elapsed_s = 0.0 if self._at_ns is None else min(1.0, max(0.0, (now_ns - self._at_ns) * 1e-9))
        self._at_ns = now_ns
        rate = self.bytes_per_s
        if seen.queue_ns >= FULL_NS:
            self._stood_ns = now_ns
        if now_ns - self._stood_ns >= _GONE_NS or now_ns >= self._excused_until_ns:
            self._excused_ns = 0
        queue_from_ns = max(FULL_NS, _VARIATION * seen.variation_ns)
        if self._excused_ns:
            queue_from_ns = max(queue_from_ns, round(_EXCUSED * self._excused_ns) + _EXCUSED_NS)
        stands = seen.queue_ns >= queue_from_ns
        if self._trial is not None and self._is_of_others(self._trial, now_ns, seen):
            rate = self._excuse(self._trial, now_ns, seen)
        elif stands and now_ns >= self._ready_ns:
            rate = self._reduced(now_ns, rate, seen)
        elif not stands:
            if self._trial is not None:
                self._last, self._trial = self._trial, None
            if self._excused_ns and self.mode != "full":
                rate = self._by_losses(now_ns, rate, seen)
            elif self.mode != "free" and now_ns >= self._ready_ns:
                self.mode = "full"
                rate *= self._growth(now_ns, seen.variation_ns) ** elapsed_s
        self.bytes_per_s = min(self.most_bytes_per_s, max(rate, least_bytes_per_s))
        if self.bytes_per_s >= self.most_bytes_per_s:
            self.mode = "free"

    def forget_queue(self, now_ns: int) -> None:
        """Restore the rate after a queue has turned out to be a route that has become longer."""
        tried = self._trial or self._last
        if tried is not None and now_ns - tried.first_ns < _SOON_NS:
            self.bytes_per_s = max(self.bytes_per_s, tried.before_bytes_per_s)
        self._trial = self._last = self._full_at = None
        if self.bytes_per_s >= self.most_bytes_per_s:
            self.mode = "free"

    def _is_of_others(self, trial: Trial, now_ns: int, seen: PathEstimate) -> bool:
        """Return whether a queue is not this end's: sending less does not lower it, or something else lowers it."""
        less = max(0.0, 1.0 - self.bytes_per_s / max(1.0, trial.carried_bytes_per_s))
        fell_ns = trial.queue_ns - seen.queue_ns
        since_ns = max(0, now_ns - trial.first_ns - seen.round_trip_ns)
        if fell_ns > _TOO_MUCH * less * since_ns + _TOO_MUCH_NS + _VARIATION * seen.variation_ns:
            return True
        if seen.delivered_bytes_per_s > _MORE * trial.carried_bytes_per_s:
            # A full line would not deliver more than before.
            return True
        acts_ns = now_ns - trial.begin_ns - self._shows_ns(trial, seen)
        least_ns = _TOO_LITTLE * min(less * (acts_ns - _LAG_NS), float(trial.queue_ns))
        is_carried = self._is_carried(seen) or trial.steps > _MOST_STEPS
        return trial.steps > 1 and is_carried and acts_ns >= _TRIED_NS and fell_ns < least_ns

    def _is_carried(self, seen: PathEstimate) -> bool:
        """Return whether the line carries the present rate: when less is delivered it is full, when more it drains."""
        return _CARRIED * self.bytes_per_s <= seen.delivered_bytes_per_s <= _MORE * self.bytes_per_s

    @staticmethod
    def _shows_ns(trial: Trial, seen: PathEstimate) -> int:
        """Return the time after which a reduction shows: it passes the queue, and its report comes back [ns]."""
        return seen.round_trip_ns + max(trial.queue_ns, seen.queue_ns)

    def _excuse(self, trial: Trial, now_ns: int, seen: PathEstimate) -> float:
        """Excuse the delay of a trial; return the rate to restore, which is about that before the trial."""
        self._trial = self._last = None
        self._excused_ns, self._excused_until_ns = max(trial.queue_ns, seen.queue_ns), now_ns + _EXCUSED_FOR_NS
        self._lost_anyway = seen.loss_share
        self._ready_ns = now_ns + max(_LOSS_PERIOD_NS, seen.round_trip_ns)
        self.mode = "shared"
        carried = self._full_at[0] if self._full_at is not None else trial.carried_bytes_per_s
        return max(self.bytes_per_s, min(trial.before_bytes_per_s, _RESTORED * carried))

    def _reduced(self, now_ns: int, rate: float, seen: PathEstimate) -> float:
        """Begin or continue a trial; return the reduced rate, a share of the delivered rate."""
        before, last = self._trial, self._last
        last = last if before is None and last is not None and now_ns - last.begin_ns < _SOON_NS else None
        if last is not None and rate < _WELL_BELOW * last.carried_bytes_per_s and self._is_carried(seen):
            # The line has just carried more than this rate and carries this one, so it is not full of it.
            most = min(last.before_bytes_per_s, _RESTORED * last.carried_bytes_per_s)
            return self._excuse(last._replace(queue_ns=seen.queue_ns, before_bytes_per_s=most), now_ns, seen)
        if before is None:
            self._full_at = min(rate, seen.delivered_bytes_per_s), now_ns
        elif now_ns - before.begin_ns < self._shows_ns(before, seen) + _TRIED_NS:
            return rate
        self.mode, self.carried_bytes_per_s = "full", seen.delivered_bytes_per_s
        self._ready_ns = now_ns + seen.round_trip_ns + _JUDGED_NS
        first = before or Trial(now_ns, now_ns, 0, rate, 0.0, 0)
        self._trial = first._replace(
            begin_ns=now_ns,
            queue_ns=seen.queue_ns,
            carried_bytes_per_s=seen.delivered_bytes_per_s,
            steps=first.steps + 1,
        )
        share = max(_LEAST_SHARE, _SHARE - (seen.queue_ns - FULL_NS) * _SHARE_PER_NS)
        return min(rate, share * seen.delivered_bytes_per_s)

    def _by_losses(self, now_ns: int, rate: float, seen: PathEstimate) -> float:
        if now_ns < self._ready_ns:
            return rate
        self._ready_ns = now_ns + max(_LOSS_PERIOD_NS, seen.round_trip_ns)
        lost = seen.loss_share - self._lost_anyway
        sent = seen.delivered_bytes_per_s / max(0.1, 1.0 - seen.loss_share)
        if lost > _MUCH_LOST:
            self.mode = "shared"
            return min(rate, sent) * (1.0 - 0.5 * lost)
        # A rate that is not reached is no limit.
        return rate * _EXCUSED_GROWTH if rate < _UNREACHED * sent else self.most_bytes_per_s

    def _growth(self, now_ns: int, variation_ns: int) -> float:
        if self._full_at is None or variation_ns >= _VARIES_NS:
            # The queue may have drained by chance; a wrong guess here costs less than slow growth.
            return _GROWTH
        full_at, since_s = self._full_at[0], (now_ns - self._full_at[1]) * 1e-9
        if not _NEAR * full_at < self.bytes_per_s < _PAST * full_at:
            return _GROWTH
        return min(_GROWTH, _CAREFUL_GROWTH + _MORE_PER_S * since_s)

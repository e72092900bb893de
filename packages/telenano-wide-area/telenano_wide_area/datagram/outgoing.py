"""What an end sends of the samples that it is offered: how many, how small, with which older ones."""

from collections.abc import Callable
from typing import NamedTuple

from telenano_wide_area.datagram.body import MOST_SAMPLE_BYTES, REPORT, Report, mark, packed
from telenano_wide_area.datagram.body import TRAIN as TRAIN_MARK
from telenano_wide_area.datagram.line import Line
from telenano_wide_area.datagram.pacing import NETWORK_BYTES, RESERVE_BYTES, Repeats, SendBudget
from telenano_wide_area.datagram.rate import WARN_QUEUE_NS, Delivery, PathEstimate, RateControl
from telenano_wide_area.datagram.sealing import OVERHEAD_BYTES
from telenano_wide_area.settings import DatagramSettings

# However full the line is, and whatever the other end says of it, this number of samples are sent in a second: a reader
# takes a silence of 50 ms for a loss.
LEAST_HZ = 50.0
# Over a full line a report of the law goes along with a sample, and no more often than this [ns].
_REPORTS_NS = 100_000_000
_REPORTED = "law/status"
# Over a full line a datagram says what was heard from the other end no more often than this [ns]: some ten times within
# the time over which a queue is judged.
_WHOLE_REPORT_NS = 9_000_000
# A train is this number of datagrams, back to back.
TRAIN_DATAGRAMS = 40
# Each datagram of a train has this number of bytes of padding.
_PADDING_BYTES = 400
# No more than one train in this time, whatever asks for it [ns].
_TRAIN_PAUSE_NS = 700_000_000
# A queue that lasts this long is reported.
_STANDS_NS = 2_000_000_000
# A queue that still lasts is reported again after this time.
_REMIND_NS = 60_000_000_000
# Means follow what is sent over some 0.3 s, at twenty updates a second.
_NEWEST_SHARE = 0.15


class SentTotal(NamedTuple):
    """What was sent up to a time [ns]."""

    now_ns: int
    bytes: int
    datagrams: int


class Outgoing:
    """The samples of one end on their way out; `line` is what it knows of both ways, `control` its rate."""

    def __init__(self, settings: DatagramSettings, now_ns: int) -> None:
        self.line = Line()
        self.control = RateControl(settings.budget_kbit_per_s * 125.0)
        self.repeats = Repeats(settings.repeats)
        self.bytes = self.datagrams = self.unsent = 0
        self._budget = SendBudget(settings.budget_kbit_per_s, now_ns)
        self._delivery = Delivery()
        self._beside, self._beside_ns = b"", now_ns
        self._whole_report_ns = now_ns
        self._seen = SentTotal(now_ns, 0, 0)
        # The mean size of a datagram [bytes], and what is sent in a second.
        self._bytes_each, self._bytes_per_s = 400.0, 0.0
        self._train_ns = now_ns - _TRAIN_PAUSE_NS
        self._full_since_ns: int | None = None
        self._queue_reported_ns: int | None = None

    def samples(self, topic: str, payload: bytes, now_ns: int) -> bytes:
        """Return what to send now that a sample is offered; empty where it is left out."""
        limited = self.control.mode != "free"
        if limited and topic == _REPORTED:
            if now_ns - self._beside_ns >= _REPORTS_NS:
                self._beside, self._beside_ns = packed(topic, payload), now_ns
            return b""
        left = self._budget.left_bytes(now_ns)
        if limited and left < 0.9 * (self._bytes_each - NETWORK_BYTES):
            # It is known before the work of packing that there is no room.
            self.unsent += 1
            return b""
        sample = packed(topic, payload)
        if len(sample) > MOST_SAMPLE_BYTES or (not limited and len(sample) + REPORT.size + OVERHEAD_BYTES > left):
            self.unsent += 1
            return b""
        samples_sent = self.repeats.with_repeats(sample, left - REPORT.size - RESERVE_BYTES)
        if self._beside and len(samples_sent) + len(self._beside) <= MOST_SAMPLE_BYTES:
            samples_sent, self._beside = samples_sent + self._beside, b""
        return samples_sent

    def leaves_report_out(self, now_ns: int) -> bool:
        """Return whether a sample goes without what was heard from the other end: 32 bytes of a line that is full."""
        if self.control.mode == "free" or now_ns - self._whole_report_ns >= _WHOLE_REPORT_NS:
            self._whole_report_ns = now_ns
            return False
        return True

    def record_sent(self, size_bytes: int) -> None:
        """Record a datagram that was sent."""
        self.bytes += size_bytes + NETWORK_BYTES
        self.datagrams += 1
        self._budget.spend(size_bytes)

    def record_heard(self, report: Report, now_ns: int) -> None:
        """Record what the other end says of what it received, in a datagram that arrived now [ns]."""
        self.line.record(report.heard_sent_ns, report.heard_ns, report.sent_ns, now_ns)
        self._delivery.record(report.heard_ns, report.expected, report.arrived)

    def record_jump(
        self,
        there_ns: int,
        back_ns: int,
        heard_ns: int,
        now_ns: int,
        *,
        back_is_full: bool,
        there_by_and_by: bool = False,
    ) -> None:
        """Record that each way takes longer, seen when something was heard [ns]: a longer route is no queue.

        Where much is lost as well it is no route but a queue that is full, of which `back_is_full` is told of the way
        back. A way there that became longer by and by, while less is sent because it is full, has to lose less than
        that for a route.
        """
        is_kept_full = there_by_and_by and self.control.mode != "free" and self._delivery.is_kept_full()
        there_ns = 0 if is_kept_full or self._delivery.is_of_full_queue() else there_ns
        back_ns = 0 if back_is_full else back_ns
        if there_ns or back_ns:
            self.line.jump(heard_ns, there_ns, back_ns)
        if there_ns:
            self.control.forget_queue(now_ns)

    def update(self, now_ns: int, round_trip_ns: int) -> None:
        """Adapt the rate to the line, some twenty times a second."""
        elapsed_s = (now_ns - self._seen.now_ns) * 1e-9
        if elapsed_s <= 0.0:
            return
        sent, datagrams = self.bytes - self._seen.bytes, self.datagrams - self._seen.datagrams
        self._seen = SentTotal(now_ns, self.bytes, self.datagrams)
        self._bytes_per_s += _NEWEST_SHARE * (sent / elapsed_s - self._bytes_per_s)
        if datagrams:
            self._bytes_each += _NEWEST_SHARE * (sent / datagrams - self._bytes_each)
        rate, queue_ns = self._delivery.rate(self._bytes_each, self._bytes_per_s), self.line.there_ns
        if rate is None or queue_ns is None:
            return
        seen = PathEstimate(queue_ns, *rate, round_trip_ns, self.line.there_variation_ns)
        self.control.update(now_ns, seen, LEAST_HZ * self._bytes_each)
        self._budget.limit(self.control.bytes_per_s, self._bytes_each, now_ns)

    def report_queue(self, now_ns: int, machine: str) -> tuple[str, str] | None:
        """Return level and text of an event when the line to a machine becomes full, still is after long, or is not."""
        queue_ns, mode, reported_ns = self.line.there_ns or 0, self.control.mode, self._queue_reported_ns
        if mode != "full" or queue_ns < WARN_QUEUE_NS:
            self._full_since_ns = None
            if mode != "free" or reported_ns is None:
                return None
            self._queue_reported_ns = None
            return "info", f"the line to {machine} is no longer full"
        if self._full_since_ns is None:
            self._full_since_ns = now_ns
        if now_ns - self._full_since_ns < _STANDS_NS or (reported_ns is not None and now_ns - reported_ns < _REMIND_NS):
            return None
        self._queue_reported_ns = now_ns
        carries = f"carries {8e-6 * self.control.carried_bytes_per_s:.3g} Mbit/s of the link's datagrams"
        queue = f"a queue of {queue_ns * 1e-6:.0f} ms stands before it"
        return "warning", f"the line to {machine}, which {carries}, is full: {queue}, and every sample is as much older"

    def adapt_repeats(self, expected: int, arrived: int) -> None:
        """Choose how many older samples each datagram repeats."""
        self.repeats.adapt(expected, arrived, full=self.control.mode != "free")

    def send_train(self, now_ns: int, send: Callable[[bytes, int], None], first: int = TRAIN_MARK) -> bool:
        """Send a train of datagrams, of which the other end sees how fast the line carries it; return whether it was.

        Args:
            now_ns: The time now [ns].
            send: Sends a body's samples at a time [ns].
            first: The mark in its datagrams, which may ask for a train in return.

        Returns:
            Whether the train was sent: not soon after another one.
        """
        if now_ns - self._train_ns < _TRAIN_PAUSE_NS:
            return False
        self._train_ns = now_ns
        # The samples behind it do not pay for it.
        saved = self._budget.saved
        for _ in range(TRAIN_DATAGRAMS):
            send(mark(first, bytes(_PADDING_BYTES)), now_ns)
        self._budget.saved = saved
        return True

    def forget_reports(self, *, new_process: bool) -> None:
        """Forget what was reported under the keys before; of a new process also its clock."""
        self.repeats.forget()
        self._delivery = Delivery()
        if new_process:
            self.line.forget()

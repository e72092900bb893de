"""Choose what an end sends of the samples that it is offered: how many, how small, and with which older ones."""

from collections.abc import Callable
from typing import NamedTuple

from telenano_wide_area.datagram.body import MOST_SAMPLE_BYTES, REPORT, Report, mark, packed
from telenano_wide_area.datagram.body import TRAIN as TRAIN_MARK
from telenano_wide_area.datagram.line import Line
from telenano_wide_area.datagram.pacing import NETWORK_BYTES, RESERVE_BYTES, Repeats, SendBudget
from telenano_wide_area.datagram.rate import WARN_QUEUE_NS, Delivery, PathEstimate, RateControl
from telenano_wide_area.datagram.sealing import OVERHEAD_BYTES
from telenano_wide_area.settings import DatagramSettings

# Least rate of samples, kept even if the line is full and the other end reports losses, because a reader takes a
# silence of 50 ms for a loss.
LEAST_HZ = 50.0
# Over a full line a report of the law is sent with a sample, at this interval at the shortest [ns].
_REPORTS_NS = 100_000_000
_REPORTED = "law/status"
# Over a full line a datagram has a full report at this interval at the shortest [ns]: some ten times within the time
# over which a queue is judged.
_WHOLE_REPORT_NS = 9_000_000
# The number of datagrams of a train, sent back to back.
TRAIN_DATAGRAMS = 40
# The padding of each datagram of a train [bytes].
_PADDING_BYTES = 400
# The shortest interval between trains, whatever asks for them [ns].
_TRAIN_PAUSE_NS = 700_000_000
# A queue that lasts for this time is reported [ns].
_STANDS_NS = 2_000_000_000
# A queue that still lasts is reported again after this time [ns].
_REMIND_NS = 60_000_000_000
# The share of the newest value in a mean: means follow over some 0.3 s, at twenty updates a second.
_NEWEST_SHARE = 0.15


class SentTotal(NamedTuple):
    """The totals sent up to a time [ns]."""

    now_ns: int
    bytes: int
    datagrams: int


class Outgoing:
    """The samples of one end on their way out; `line` has the queues of both directions, `control` the rate."""

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
        # The mean size of a datagram [bytes], and the mean rate of sending [bytes/s].
        self._bytes_each, self._bytes_per_s = 400.0, 0.0
        self._train_ns = now_ns - _TRAIN_PAUSE_NS
        self._full_since_ns: int | None = None
        self._queue_reported_ns: int | None = None

    def samples(self, topic: str, payload: bytes, now_ns: int) -> bytes:
        """Return the bytes to send for a sample that is offered now; empty if the sample is left out."""
        limited = self.control.mode != "free"
        if limited and topic == _REPORTED:
            if now_ns - self._beside_ns >= _REPORTS_NS:
                self._beside, self._beside_ns = packed(topic, payload), now_ns
            return b""
        left = self._budget.left_bytes(now_ns)
        if limited and left < 0.9 * (self._bytes_each - NETWORK_BYTES):
            # There is no room for a mean sample, so the work of packing is saved.
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
        """Return whether a sample is sent with a short report, which saves 32 bytes of a full line."""
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
        """Record the other end's report of its arrivals, from a datagram that arrived now [ns]."""
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
        """Record that the directions take longer by these times [ns], as seen at heard_ns: a longer route is no queue.

        If much is lost as well, it is no route but a full queue; `back_is_full` says so for the direction to here. A
        delay there that grew gradually, while less was sent because the line was full, is a queue already at the
        smaller loss of a queue that is kept full.
        """
        is_kept_full = there_by_and_by and self.control.mode != "free" and self._delivery.is_kept_full()
        there_ns = 0 if is_kept_full or self._delivery.is_of_full_queue() else there_ns
        back_ns = 0 if back_is_full else back_ns
        if there_ns or back_ns:
            self.line.jump(heard_ns, there_ns, back_ns)
        if there_ns:
            self.control.forget_queue(now_ns)

    def update(self, now_ns: int, round_trip_ns: int) -> None:
        """Adapt the rate to the line; called some twenty times a second."""
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
        """Return level and text of an event when the line to a machine becomes full, stays full, or is free again."""
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
        """Send a train of datagrams, by which the other end measures the capacity of the line.

        Args:
            now_ns: The time now [ns].
            send: Sends the samples of a body at a time [ns].
            first: The mark in its datagrams, which may ask for a train in return.

        Returns:
            Whether the train was sent, which it is not soon after another one.
        """
        if now_ns - self._train_ns < _TRAIN_PAUSE_NS:
            return False
        self._train_ns = now_ns
        # The samples after the train do not pay for it.
        saved = self._budget.saved
        for _ in range(TRAIN_DATAGRAMS):
            send(mark(first, bytes(_PADDING_BYTES)), now_ns)
        self._budget.saved = saved
        return True

    def forget_reports(self, *, new_process: bool) -> None:
        """Forget the reports under the previous keys; for a new process, which has another clock, also the line."""
        self.repeats.forget()
        self._delivery = Delivery()
        if new_process:
            self.line.forget()

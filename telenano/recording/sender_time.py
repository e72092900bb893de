"""The messages of a recording in the order and at the times of their sending.

A recording is in the order of reception, and a recorder, which runs behind the loop, may be late by seconds, by a
different time for each publisher. Played at those times a stream of one message a millisecond would come in bursts with
pauses between them, and the devices would take each pause for a loss of the connection.
"""

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator
from itertools import islice
from typing import NamedTuple

from telenano.recording.messages import ChannelFilter, RecordedChannel, RecordedMessage
from telenano.recording.multi_file import RecordingSource
from telenano.recording.site_clock import ClockShift, is_of_slave, read_site_clock
from telenano.settings.package_topics import row_of
from telenano.wire.ends import END_TOPIC, read_end
from telenano.wire.errors import RecordingError
from telenano.wire.messages import LinkFates

FATES_TOPIC = "link/fates"
_NS = 1_000_000_000
# a recorder that lags by more would have lost messages: then the publisher has another clock
_LONGEST_LAG_NS = 30 * _NS
# A message may come so far behind the newest one that was sent after it, in addition to the lag seen.
_LEAST_HORIZON_NS = 3 * _NS // 2
# The link reports the fate of a message within a tenth of a second, and the report may lag as well.
_FATE_PATIENCE_NS = _NS
_MOST_FATES = 100_000
# This number of messages are read and sorted together, and a player stands still for it.
_READ_AT_ONCE = 128
# This number of messages are read and sorted together where the player reads ahead.
_READ_AHEAD = 16
# below this rate [Hz] a topic may have several sources with the same numbers, and the exact time matters less
_FAST_HZ = 100.0


class SentMessage(NamedTuple):
    """A message and when it was sent [ns], on the recorder's clock; `place` is that in the file."""

    time_ns: int
    place: int
    message: RecordedMessage


class SenderClock:
    """Time of sending of messages received at their publisher, on the recorder's clock [ns].

    Processes of one machine share a clock, and their stamps are taken as they are. The other site of two machines is
    put on the master's clock, offset and drift, where the clocks differ (`telenano.recording.site_clock`). A source
    whose stamps are those of another time, because it was itself a replay, is shifted by the lag of its first message.
    """

    def __init__(self, recording: RecordingSource) -> None:
        self.of_slave = ClockShift(read_site_clock(recording))
        # The shift of each source; None means that the clock of the slave's site applies to it.
        self._shifts: dict[str, int | None] = {}

    def time_ns(self, message: RecordedMessage) -> int:
        """Return when a message was sent."""
        shift = self.shift_ns(message)
        return message.publish_ns + (self.of_slave(message.publish_ns) if shift is None else shift)

    def shift_ns(self, message: RecordedMessage) -> int | None:
        """Return the shift of the source of a message [ns]; None means that `of_slave` has it for each stamp."""
        src = message.channel.src
        if src not in self._shifts:
            self._shifts[src] = self._shift_ns(message)
        return self._shifts[src]

    def _shift_ns(self, message: RecordedMessage) -> int | None:
        is_shifted = self.of_slave.is_needed and is_of_slave(message.src)
        lag_ns = message.log_ns - message.publish_ns
        shown_ns = lag_ns - (self.of_slave(message.publish_ns) if is_shifted else 0)
        if not -_LEAST_HORIZON_NS <= shown_ns <= _LONGEST_LAG_NS:
            return lag_ns
        return None if is_shifted else 0


class _Known(NamedTuple):
    """A channel, the shift of its source, whether it is wanted, and whether nothing in its messages matters."""

    channel: RecordedChannel
    shift_ns: int | None
    wanted: bool
    is_plain: bool


class SenderOrder:
    """Selected messages of a recording from a time of sending on, in the order of sending.

    What left the link is sent by the link: its time is that of `link/fates`, and where a recording lacks those, that of
    the publisher and the delay reported last, or the least seen on the channel. The last message of a publisher is left
    out but where it is asked for: it counts messages, and a replay may send others.
    """

    def __init__(
        self,
        recording: RecordingSource,
        wanted: Callable[[RecordedChannel], bool],
        clock: SenderClock,
        first_ns: int | None = None,
        *,
        select: Callable[[ChannelFilter, int | None], Iterator[RecordedMessage]] | None = None,
        ends: bool = False,
    ) -> None:
        """Begin with what was sent at `first_ns` [ns] or later, None for the beginning.

        Args:
            recording: The recording to read.
            wanted: Whether a channel is wanted.
            clock: The clocks of the senders.
            first_ns: The earliest time of sending [ns]; None begins at the beginning.
            select: Reads the recording; None takes its own `select`.
            ends: Whether the last messages of publishers are among those that are read.
        """
        self._ends = ends
        self._clock = clock
        self._wanted = wanted
        # What is known of a channel, by its identity: its hash, of all its fields, takes longer than all the rest.
        self._known: dict[int, _Known] = {}
        links = any(channel.via == "link" and wanted(channel) for channel in recording.channels)
        reports = any(channel.topic == FATES_TOPIC for channel in recording.channels)
        self._fates: _Fates | None = _Fates() if links and reports else None
        start_ns = None if first_ns is None else max(0, first_ns - _LEAST_HORIZON_NS)
        self._source: Iterator[RecordedMessage] = (select or recording.select)(self._needs, start_ns)
        # Messages that were just read are in no order.
        self._arrived: list[SentMessage] = []
        # Something may still come before a pending message, and nothing before a ready one; both are in the order of
        # sending. The reader takes the ready ones from the left.
        self._pending: list[SentMessage] = []
        self.ready: deque[SentMessage] = deque()
        # Messages that left the link and are not reported yet, by channel, each with the time at which the link
        # received it.
        self._waiting: dict[RecordedChannel, deque[SentMessage]] = {}
        self._read_ns = 0
        self._most_lag_ns = 0
        self._place = 0
        # The delay that the link reported last, by channel, or else the least that was seen.
        self._delay_ns: dict[RecordedChannel, int] = {}
        self._exhausted = False
        # The newest message of each channel that was sent before the beginning.
        self.before: dict[RecordedChannel, SentMessage] = {}
        while first_ns is not None and (message := self.peek()) is not None and message.time_ns < first_ns:
            self.before[message.message.channel] = message
            self.pop()

    def peek(self) -> SentMessage | None:
        """Return the next message without moving on; None at the end."""
        while not self.ready:
            if self._exhausted:
                return None
            self._read_on()
        return self.ready[0]

    def pop(self) -> None:
        """Move past the next message."""
        self.ready.popleft()

    def read_ahead(self, least: int, count: int = _READ_AHEAD) -> bool:
        """Read on unless this number of messages are ready; return whether there may be more to read."""
        if len(self.ready) >= least or self._exhausted:
            return False
        self._read_on(count)
        return True

    def __iter__(self) -> Iterator[SentMessage]:
        while (message := self.peek()) is not None:
            self.pop()
            yield message

    def _needs(self, channel: RecordedChannel) -> bool:
        return self._wanted(channel) or (self._fates is not None and channel.topic == FATES_TOPIC)

    def _read_on(self, count: int = _READ_AT_ONCE) -> None:
        """Read a number of messages, sort what is pending, and make ready what nothing can have been sent before."""
        before, entries, arrived, new = self._place, self._known, self._arrived, tuple.__new__
        for message in islice(self._source, count):
            channel, log_ns, publish_ns, _, _ = message
            _, shift_ns, wanted, is_plain = entries.get(id(channel)) or self._look_at(message)
            time_ns = publish_ns + (self._clock.of_slave(publish_ns) if shift_ns is None else shift_ns)
            self._place += 1
            if log_ns > self._read_ns:
                self._read_ns = log_ns
            if not is_plain:
                self._add(message, time_ns, wanted)
                continue
            if log_ns - time_ns > self._most_lag_ns:
                self._most_lag_ns = log_ns - time_ns
            # The constructor of a named tuple is a function of Python.
            arrived.append(new(SentMessage, (time_ns, self._place, message)))
        if self._place - before < count:
            self._exhausted = True
            self._release_waiting(0)
        self._sort_in()
        count = len(self._pending) if self._exhausted else bisect_left(self._pending, (self._settled_ns(),))
        self.ready.extend(self._pending[:count])
        del self._pending[:count]

    def _look_at(self, message: RecordedMessage) -> "_Known":
        """Find out how the messages of a channel are handled."""
        channel = message.channel
        wanted = self._wanted(channel)
        is_plain = wanted and channel.via != "link" and channel.topic not in (FATES_TOPIC, END_TOPIC)
        entry = self._known[id(channel)] = _Known(channel, self._clock.shift_ns(message), wanted, is_plain)
        return entry

    def _sort_in(self) -> None:
        """Sort what has arrived into what is pending, which it mostly follows."""
        if self._arrived:
            first = bisect_left(self._pending, min(self._arrived))
            self._pending[first:] = sorted([*self._pending[first:], *self._arrived])
            self._arrived.clear()

    def _settled_ns(self) -> int:
        """Return the time of sending [ns] before which nothing comes that was not read, or that waits for its fate."""
        settled_ns = self._read_ns - self._most_lag_ns * 5 // 4 - _LEAST_HORIZON_NS
        return min([settled_ns, *(waiting[0].time_ns for waiting in self._waiting.values() if waiting)])

    def _add(self, message: RecordedMessage, time_ns: int, wanted: bool) -> None:
        if message.channel.via == "link":
            self._add_forwarded(message, time_ns)
        else:
            self._add_direct(message, time_ns, wanted)
        if self._fates is not None and message.channel.topic == FATES_TOPIC:
            self._release_waiting(_FATE_PATIENCE_NS + 2 * self._most_lag_ns)

    def _add_direct(self, message: RecordedMessage, time_ns: int, wanted: bool) -> None:
        self._most_lag_ns = max(self._most_lag_ns, message.log_ns - time_ns)
        if self._fates is not None and message.topic == FATES_TOPIC:
            self._fates.record(message, time_ns - message.publish_ns)
        if wanted and (self._ends or not _is_end(message)):
            self._arrived.append(SentMessage(time_ns, self._place, message))

    def _add_forwarded(self, message: RecordedMessage, time_ns: int) -> None:
        if self._fates is not None and _is_fast(message.topic):
            waiting = self._waiting.setdefault(message.channel, deque())
            waiting.append(SentMessage(time_ns, self._place, message))
        else:
            self._add_guessed(SentMessage(time_ns, self._place, message))

    def _release_waiting(self, patience_ns: int) -> None:
        """Move on what has its fate, and what was received longer ago than the patience [ns]."""
        for waiting in self._waiting.values():
            while waiting:
                arrived_ns, place, message = waiting[0]
                time_ns = None if self._fates is None else self._fates.take(message.topic, message.seq)
                if time_ns is not None:
                    self._delay_ns[message.channel] = time_ns - arrived_ns
                    self._arrived.append(SentMessage(time_ns, place, message))
                elif message.log_ns <= self._read_ns - patience_ns:
                    self._add_guessed(waiting[0])
                else:
                    break
                waiting.popleft()

    def _add_guessed(self, sent: SentMessage) -> None:
        delay_ns, message = sent.message.log_ns - sent.time_ns, sent.message
        delay_ns = min(delay_ns, self._delay_ns.get(message.channel, delay_ns))
        self._delay_ns[message.channel] = delay_ns
        self._arrived.append(SentMessage(sent.time_ns + max(0, delay_ns), sent.place, message))


class _Fates:
    """When the link sent messages on [ns], by topic and seq; of a duplicate the second time as well."""

    def __init__(self) -> None:
        self._times_ns: dict[tuple[str, int], list[int]] = {}

    def record(self, message: RecordedMessage, shift_ns: int) -> None:
        """Take note of a report, whose times are shifted onto the recorder's clock."""
        try:
            report = message.decode()
        except RecordingError:
            return
        for fate in report.fates if isinstance(report, LinkFates) else ():
            if not fate.dropped and _is_fast(fate.topic):
                times = self._times_ns.setdefault((fate.topic, fate.seq), [])
                times.append(fate.arrived_ns + fate.delay_ns + shift_ns)
        while len(self._times_ns) > _MOST_FATES:
            del self._times_ns[next(iter(self._times_ns))]

    def take(self, topic: str, seq: int) -> int | None:
        """Return and forget when a message was sent on; None where that is not known."""
        times = self._times_ns.get((topic, seq))
        if times is None:
            return None
        time_ns = times.pop(0)
        if not times:
            del self._times_ns[topic, seq]
        return time_ns


def _is_fast(topic: str) -> bool:
    row = row_of(topic)
    return row is not None and (row.rate_hz or 0.0) >= _FAST_HZ


def _is_end(message: RecordedMessage) -> bool:
    if message.channel.topic != END_TOPIC:
        return False
    try:
        return read_end(message.fields()) is not None
    except RecordingError:
        return False

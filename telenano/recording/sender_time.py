"""Messages of a recording in the order of their send times, for playback and export.

A recording is in the order of reception, and the recorder may lag behind the loop by seconds, differently for each
publisher. Played at reception times, a stream of one message per millisecond would come in bursts, and the devices
would treat each pause between them as a loss of the connection.
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
# A recorder that lags by more would have lost messages, so a longer lag means that the publisher has another clock.
_LONGEST_LAG_NS = 30 * _NS
# A message may be recorded this much later than one sent after it, in addition to the observed lag [ns].
_LEAST_HORIZON_NS = 3 * _NS // 2
# The link reports the fate of a message within a tenth of a second, and the report may lag as well.
_FATE_PATIENCE_NS = _NS
_MOST_FATES = 100_000
# Messages that are read and sorted together while the player waits.
_READ_AT_ONCE = 128
# Messages that are read and sorted together when the player reads ahead.
_READ_AHEAD = 16
# Slower topics may have several sources with the same seq, and their exact time matters less [Hz].
_FAST_HZ = 100.0


class SentMessage(NamedTuple):
    """A message with its send time by the recorder's clock [ns] and its place in the file, which breaks ties."""

    time_ns: int
    place: int
    message: RecordedMessage


class SenderClock:
    """Converts the stamps of messages to send times by the recorder's clock [ns].

    Processes of one machine share a clock, so their stamps stay unchanged. Stamps of a slave's site on another machine
    are corrected for offset and drift if the clocks differ (`telenano.recording.site_clock`). A source that was itself
    replayed has old stamps; they are shifted by the lag of its first message.
    """

    def __init__(self, recording: RecordingSource) -> None:
        self.of_slave = ClockShift(read_site_clock(recording))
        # Constant shift of each source; None: the clock of the slave's site gives the shift of each stamp.
        self._shifts: dict[str, int | None] = {}

    def time_ns(self, message: RecordedMessage) -> int:
        """Return the send time of a message by the recorder's clock [ns]."""
        shift = self.shift_ns(message)
        return message.publish_ns + (self.of_slave(message.publish_ns, message.log_ns) if shift is None else shift)

    def shift_ns(self, message: RecordedMessage) -> int | None:
        """Return the constant shift of a message's source [ns]; None if `of_slave` gives the shift of each stamp."""
        src = message.channel.src
        if src not in self._shifts:
            self._shifts[src] = self._shift_ns(message)
        return self._shifts[src]

    def _shift_ns(self, message: RecordedMessage) -> int | None:
        is_shifted = self.of_slave.is_needed and is_of_slave(message.src)
        lag_ns = message.log_ns - message.publish_ns
        shown_ns = lag_ns - (self.of_slave(message.publish_ns, message.log_ns) if is_shifted else 0)
        if not -_LEAST_HORIZON_NS <= shown_ns <= _LONGEST_LAG_NS:
            return lag_ns
        return None if is_shifted else 0


class _Known(NamedTuple):
    """A channel, the shift of its source [ns], whether it is wanted, and whether it needs no special handling."""

    channel: RecordedChannel
    shift_ns: int | None
    wanted: bool
    is_plain: bool


class SenderOrder:
    """Iterator over the selected messages of a recording in order of send time, from a given time on.

    Messages behind the link have the time at which the link sent them on, from `link/fates`. If the recording lacks
    that, it is the publisher's time plus the last reported delay, or the least one seen on the channel. End messages of
    publishers are left out unless `ends` is set: they count messages, and a replay may send another number.
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
        """Begin with the first message sent at `first_ns` or later.

        Args:
            recording: The recording to read.
            wanted: Predicate of the channels to yield.
            clock: The clocks of the senders.
            first_ns: The earliest send time [ns]; None for the beginning.
            select: Function that reads the recording; None for `recording.select`.
            ends: Whether to include the end messages of publishers.
        """
        self._ends = ends
        self._clock = clock
        self._wanted = wanted
        # Facts on each channel, by `id`: hashing a channel (all its fields) takes longer than all the rest.
        self._known: dict[int, _Known] = {}
        links = any(channel.via == "link" and wanted(channel) for channel in recording.channels)
        reports = any(channel.topic == FATES_TOPIC for channel in recording.channels)
        self._fates: _Fates | None = _Fates() if links and reports else None
        start_ns = None if first_ns is None else max(0, first_ns - _LEAST_HORIZON_NS)
        self._source: Iterator[RecordedMessage] = (select or recording.select)(self._needs, start_ns)
        # Messages that were just read, unsorted.
        self._arrived: list[SentMessage] = []
        # Both in order of send time. An earlier message may still precede a pending one, but no ready one. The reader
        # takes ready messages from the left.
        self._pending: list[SentMessage] = []
        self.ready: deque[SentMessage] = deque()
        # Messages behind the link whose fate is not read yet, by channel, with the time at which the link got them.
        self._waiting: dict[RecordedChannel, deque[SentMessage]] = {}
        self._read_ns = 0
        self._most_lag_ns = 0
        self._place = 0
        # Last reported delay of the link by channel, or else the least one seen [ns].
        self._delay_ns: dict[RecordedChannel, int] = {}
        self._exhausted = False
        # Newest message of each channel that was sent before `first_ns`.
        self.before: dict[RecordedChannel, SentMessage] = {}
        while first_ns is not None and (message := self.peek()) is not None and message.time_ns < first_ns:
            self.before[message.message.channel] = message
            self.pop()

    def peek(self) -> SentMessage | None:
        """Return the next message without consuming it; None at the end."""
        while not self.ready:
            if self._exhausted:
                return None
            self._read_on()
        return self.ready[0]

    def pop(self) -> None:
        """Consume the next message."""
        self.ready.popleft()

    def read_ahead(self, least: int, count: int = _READ_AHEAD) -> bool:
        """Read `count` more messages if fewer than `least` are ready; return whether anything was read."""
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
        """Read messages, sort the pending ones, and move to `ready` those that no unread message can precede."""
        before, entries, arrived, new = self._place, self._known, self._arrived, tuple.__new__
        for message in islice(self._source, count):
            channel, log_ns, publish_ns, _, _ = message
            _, shift_ns, wanted, is_plain = entries.get(id(channel)) or self._look_at(message)
            time_ns = publish_ns + (self._clock.of_slave(publish_ns, log_ns) if shift_ns is None else shift_ns)
            self._place += 1
            if log_ns > self._read_ns:
                self._read_ns = log_ns
            if not is_plain:
                self._add(message, time_ns, wanted)
                continue
            if log_ns - time_ns > self._most_lag_ns:
                self._most_lag_ns = log_ns - time_ns
            # `tuple.__new__` is faster than the constructor of a named tuple, a Python function.
            arrived.append(new(SentMessage, (time_ns, self._place, message)))
        if self._place - before < count:
            self._exhausted = True
            self._release_waiting(0)
        self._sort_in()
        count = len(self._pending) if self._exhausted else bisect_left(self._pending, (self._settled_ns(),))
        self.ready.extend(self._pending[:count])
        del self._pending[:count]

    def _look_at(self, message: RecordedMessage) -> "_Known":
        """Determine and remember the handling of a channel's messages."""
        channel = message.channel
        wanted = self._wanted(channel)
        is_plain = wanted and channel.via != "link" and channel.topic not in (FATES_TOPIC, END_TOPIC)
        entry = self._known[id(channel)] = _Known(channel, self._clock.shift_ns(message), wanted, is_plain)
        return entry

    def _sort_in(self) -> None:
        """Sort the newly read messages into the pending ones, which they mostly follow."""
        if self._arrived:
            first = bisect_left(self._pending, min(self._arrived))
            self._pending[first:] = sorted([*self._pending[first:], *self._arrived])
            self._arrived.clear()

    def _settled_ns(self) -> int:
        """Return the send time [ns] before which no message is unread or still waits for its fate."""
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
        """Release the messages whose fate is known, and those received longer than `patience_ns` [ns] ago."""
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
    """Times at which the link sent messages on [ns], by topic and seq; a duplicated message has several."""

    def __init__(self) -> None:
        self._times_ns: dict[tuple[str, int], list[int]] = {}

    def record(self, message: RecordedMessage, shift_ns: int) -> None:
        """Store the times of a report, shifted by `shift_ns` onto the recorder's clock."""
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
        """Return and remove the time at which the link sent a message on [ns]; None if unknown."""
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

"""Playback of a recording: position, next message and state at a position, and the clock of the playback.

It needs neither a socket nor a clock: `Playback` uses only times of the recording, which `PlaybackClock` maps to the
time of playing.
"""

from dataclasses import dataclass

from telenano.recording.messages import ChannelFilter, RecordedChannel, RecordedMessage
from telenano.recording.multi_file import RecordingSource
from telenano.recording.recorded_time import RecordedTime, time_in
from telenano.recording.sender_time import SenderClock, SenderOrder, SentMessage
from telenano.settings.package_topics import row_of
from telenano.wire.errors import RecordingError

_NS = 1e9
_LONGEST_NS = 10**18
# Number of messages to keep ready, if there is time to read ahead.
_READY = 256


@dataclass(frozen=True)
class Span:
    """Range to play; a number is a time from the start of the recording [s]. With `loop` it repeats."""

    start_s: float | RecordedTime = 0.0
    end_s: float | RecordedTime | None = None
    loop: bool = False


class Playback:
    """The selected messages of a recording in order of send time.

    Positions are send times in ns of the recorder's clock.
    """

    def __init__(self, recording: RecordingSource, channel_filter: ChannelFilter, span: Span) -> None:
        """Start at the beginning of the span; raise RecordingError if there is nothing to play."""
        self.recording = recording
        first_ns, last_ns = recording.span_ns
        self._clock = SenderClock(recording)
        first = next(recording.select(), None)
        self.origin_ns = first_ns if first is None else min(first_ns, self._clock.time_ns(first))
        self.channel_filter = channel_filter
        self.loop = span.loop
        self.length_s = (last_ns - self.origin_ns) / _NS
        self.channels = tuple(channel for channel in recording.channels if channel_filter(channel))
        if not self.channels:
            raise RecordingError(f"{recording.path}: has none of the messages that were selected")
        self._last_ns = last_ns
        self.start_ns = self._limited(time_in(self.origin_ns, span.start_s))
        self.end_ns = last_ns + 1 if span.end_s is None else self._limited(time_in(self.origin_ns, span.end_s))
        if self.start_ns > last_ns or self.end_ns <= self.start_ns:
            from_s, to_s = ((each - self.origin_ns) / _NS for each in (self.start_ns, min(self.end_ns, last_ns)))
            raise RecordingError(
                f"{recording.path}: is {self.length_s:.3f} s long, there is nothing from {from_s:g} s to {to_s:g} s"
            )
        self.position_ns = self.start_ns
        self._order = self._from(self.start_ns)

    def at(self, time_s: float) -> int:
        """Return the position [ns] of a time [s] from the start of the recording, limited to about thirty years."""
        return self._limited(time_in(self.origin_ns, time_s))

    def _limited(self, at_ns: int) -> int:
        return min(max(at_ns, self.origin_ns - _LONGEST_NS), self.origin_ns + _LONGEST_NS)

    @property
    def time_s(self) -> float:
        """The position as time [s] from the start of the recording."""
        return (self.position_ns - self.origin_ns) / _NS

    def next(self) -> SentMessage | None:
        """Return the next message with its send time [ns]; None at the end of the span."""
        ready = self._order.ready
        sent = ready[0] if ready else self._order.peek()
        return None if sent is None or sent[0] >= self.end_ns else sent

    def advance(self, message: SentMessage) -> None:
        """Consume the next message, which must be `message`."""
        if message[0] > self.position_ns:
            self.position_ns = message[0]
        self._order.ready.popleft()

    def read_ahead(self, count: int | None = None) -> bool:
        """Read messages ahead, so that `next` need not; return whether anything was read.

        Args:
            count: Number of messages to read if fewer than this are ready; None reads a few if fewer than `_READY` are.
        """
        return self._order.read_ahead(_READY) if count is None else self._order.read_ahead(count, count)

    def peek(self) -> RecordedMessage | None:
        """Return the next message without consuming it; None at the end of the span."""
        sent = self.next()
        return None if sent is None else sent.message

    @property
    def next_ns(self) -> int:
        """Send time of the next message [ns]; the end of the span if there is none."""
        sent = self.next()
        return self.end_ns if sent is None else sent.time_ns

    def pop(self) -> RecordedMessage:
        """Return and consume the next message; raise RecordingError at the end."""
        sent = self.next()
        if sent is None:
            raise RecordingError(f"{self.recording.path}: there is no message after {self.time_s:.3f} s")
        self.advance(sent)
        return sent.message

    def seek(self, position_ns: int) -> list[RecordedMessage]:
        """Move to a position [ns], clamped to the recording; return the state there, see `state`."""
        target = min(max(position_ns, self.origin_ns), self._last_ns)
        if target >= self.end_ns:
            # A target beyond the end of the span extends the span, because the user wants to see it.
            self.end_ns = self._last_ns + 1
        return self._move_to(target)

    def rewind(self) -> list[RecordedMessage]:
        """Move to the start of the span; return the state there, see `state`."""
        return self._move_to(self.start_ns)

    def state(self) -> list[RecordedMessage]:
        """Return the newest message of each state topic before the present position, in order of send time.

        A reader needs them after a jump. Topics of which every message counts, such as commands and events, are not
        repeated.
        """

        def is_wanted(channel: RecordedChannel) -> bool:
            return self.channel_filter(channel) and is_state(channel)

        earlier = self.recording.newest_before(self.position_ns, is_wanted)
        newest = {channel: (self._clock.time_ns(message), message) for channel, message in earlier.items()}
        # Messages that were sent before the position but received after it.
        newest |= {channel: sent[::2] for channel, sent in self._order.before.items() if is_wanted(channel)}
        return [message for _, message in sorted(newest.values(), key=lambda row: row[0])]

    def next_event_ns(self) -> int | None:
        """Return the send time of the next session/event after the position [ns]; None if there is none."""
        events = self.recording.select(
            lambda channel: channel.topic == "session/event" and channel.via == "direct", self.position_ns + 1
        )
        times_ns = map(self._clock.time_ns, events)
        return next((time_ns for time_ns in times_ns if time_ns > self.position_ns), None)

    def limit(self, start_ns: int | None = None, end_ns: int | None = None) -> None:
        """Change the bounds of the range to play [ns], the points A and B of a loop; None leaves one unchanged.

        Raises RecordingError if B does not come after A.
        """
        start = self.start_ns if start_ns is None else start_ns
        end = self.end_ns if end_ns is None else end_ns
        if end <= start:
            begin_s = (start - self.origin_ns) / _NS
            raise RecordingError(f"the end of a loop must come after its start at {begin_s:.3f} s")
        self.start_ns, self.end_ns = start, end

    def _move_to(self, position_ns: int) -> list[RecordedMessage]:
        self.position_ns = position_ns
        self._order = self._from(position_ns)
        return self.state()

    def _from(self, position_ns: int) -> SenderOrder:
        first_ns = position_ns if position_ns > self.origin_ns else None
        return SenderOrder(self.recording, self.channel_filter, self._clock, first_ns)


def is_state(channel: RecordedChannel) -> bool:
    """Return whether a channel has a state topic, whose newest message replaces the earlier ones."""
    row = row_of(channel.topic)
    return row is not None and row.delivery == "latest"


class PlaybackClock:
    """Maps positions of the recording to times of a monotonic clock [ns].

    `rate` 1 is as recorded, 2 twice as fast, 0 as fast as possible: everything is due at once.
    """

    def __init__(self, now_ns: int, position_ns: int, rate: float, *, paused: bool) -> None:
        self.rate = rate
        self.paused = paused
        self._now_ns = now_ns
        self._position_ns = position_ns

    def due_ns(self, position_ns: int) -> int | None:
        """Return the time at which a position is due [ns]; None while paused."""
        if self.paused:
            return None
        if self.rate == 0.0:
            return self._now_ns
        return self._now_ns + round((position_ns - self._position_ns) / self.rate)

    def change(self, now_ns: int, position_ns: int, *, rate: float | None = None, paused: bool | None = None) -> None:
        """Continue from a position at another rate, or pause; None leaves a setting unchanged."""
        self._now_ns, self._position_ns = now_ns, position_ns
        self.rate = self.rate if rate is None else rate
        self.paused = self.paused if paused is None else paused

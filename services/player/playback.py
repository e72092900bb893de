"""Playback of a recording: position, next message, state at a position; and the clock of the playback.

No socket and no clock of the machine: `Playback` knows times of the recording only, `PlaybackClock` maps them to
the time of playing.
"""

from dataclasses import dataclass

from telenano.recording.messages import ChannelFilter, RecordedChannel, RecordedMessage
from telenano.recording.multi_file import RecordingSource
from telenano.recording.sender_time import SenderClock, SenderOrder, SentMessage
from telenano.settings.package_topics import row_of
from telenano.wire.errors import RecordingError

_NS = 1e9
_LONGEST_S = 1e9
# messages that are ready to be played, if there is time to read them before
_READY = 256


@dataclass(frozen=True)
class Span:
    """What is played: times [s] from the start of the recording; `loop` begins again at `start_s` after `end_s`."""

    start_s: float = 0.0
    end_s: float | None = None
    loop: bool = False


class Playback:
    """The selected messages of a recording in the order of their sending.

    Positions are in ns on the recorder's clock, at the time of sending.
    """

    def __init__(self, recording: RecordingSource, channel_filter: ChannelFilter, span: Span) -> None:
        """Start at the beginning of the span; RecordingError when there is nothing to play."""
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
        self.start_ns = self.at(span.start_s)
        self.end_ns = last_ns + 1 if span.end_s is None else self.at(span.end_s)
        if self.start_ns > last_ns or self.end_ns <= self.start_ns:
            raise RecordingError(
                f"{recording.path}: is {self.length_s:.3f} s long, "
                f"there is nothing from {span.start_s:g} s to {self.length_s if span.end_s is None else span.end_s:g} s"
            )
        self.position_ns = self.start_ns
        self._order = self._from(self.start_ns)

    def at(self, time_s: float) -> int:
        """Return the position [ns] of a time [s] from the start of the recording; none is further than thirty years."""
        return self.origin_ns + round(min(max(time_s, -_LONGEST_S), _LONGEST_S) * _NS)

    @property
    def time_s(self) -> float:
        """The position as time [s] from the start of the recording."""
        return (self.position_ns - self.origin_ns) / _NS

    def next(self) -> SentMessage | None:
        """Return the next message with the time [ns] at which it was sent; None at the end of the span."""
        ready = self._order.ready
        sent = ready[0] if ready else self._order.peek()
        return None if sent is None or sent[0] >= self.end_ns else sent

    def advance(self, message: SentMessage) -> None:
        """Move past the next message, which is `message`."""
        if message[0] > self.position_ns:
            self.position_ns = message[0]
        self._order.ready.popleft()

    def read_ahead(self, count: int | None = None) -> bool:
        """Read messages, for `next` not to; return whether there may be more to read.

        Args:
            count: This number of are read where fewer are ready; None reads a few unless enough are.
        """
        return self._order.read_ahead(_READY) if count is None else self._order.read_ahead(count, count)

    def peek(self) -> RecordedMessage | None:
        """Return the next message without moving on; None at the end of the span."""
        sent = self.next()
        return None if sent is None else sent.message

    @property
    def next_ns(self) -> int:
        """When the next message was sent [ns]; the end of the span where there is none."""
        sent = self.next()
        return self.end_ns if sent is None else sent.time_ns

    def pop(self) -> RecordedMessage:
        """Return the next message and move past it; RecordingError at the end."""
        sent = self.next()
        if sent is None:
            raise RecordingError(f"{self.recording.path}: there is no message after {self.time_s:.3f} s")
        self.advance(sent)
        return sent.message

    def seek(self, position_ns: int) -> list[RecordedMessage]:
        """Move to a position [ns], clamped to the recording; return the state there, as `state`."""
        target = min(max(position_ns, self.origin_ns), self._last_ns)
        if target >= self.end_ns:
            # beyond the end of the span: the user wants to see it
            self.end_ns = self._last_ns + 1
        return self._move_to(target)

    def rewind(self) -> list[RecordedMessage]:
        """Move to the start of the span; return the state there."""
        return self._move_to(self.start_ns)

    def state(self) -> list[RecordedMessage]:
        """Return the last value of each state topic before the place last moved to, by time: what a reader must know.

        Topics of which every message counts, such as commands and events, are not repeated.
        """

        def is_wanted(channel: RecordedChannel) -> bool:
            return self.channel_filter(channel) and is_state(channel)

        earlier = self.recording.newest_before(self.position_ns, is_wanted)
        newest = {channel: (self._clock.time_ns(message), message) for channel, message in earlier.items()}
        # what was sent before the position and received after it
        newest |= {channel: sent[::2] for channel, sent in self._order.before.items() if is_wanted(channel)}
        return [message for _, message in sorted(newest.values(), key=lambda row: row[0])]

    def next_event_ns(self) -> int | None:
        """Return the time [ns] of the next session/event of the recording after the position; None without one."""
        events = self.recording.select(
            lambda channel: channel.topic == "session/event" and channel.via == "direct", self.position_ns + 1
        )
        times_ns = map(self._clock.time_ns, events)
        return next((time_ns for time_ns in times_ns if time_ns > self.position_ns), None)

    def limit(self, start_ns: int | None = None, end_ns: int | None = None) -> None:
        """Change the bounds [ns] of what is played: the points A and B of a loop.

        Raises RecordingError when B does not come after A.
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
    """Return whether the newest message of a channel replaces the ones before it."""
    row = row_of(channel.topic)
    return row is not None and row.delivery == "latest"


class PlaybackClock:
    """Time at which a position of the recording is due, in ns of a monotonic clock.

    `rate` 1 is as recorded, 2 twice as fast, 0 as fast as possible: everything is due at once.
    """

    def __init__(self, now_ns: int, position_ns: int, rate: float, *, paused: bool) -> None:
        self.rate = rate
        self.paused = paused
        self._now_ns = now_ns
        self._position_ns = position_ns

    def due_ns(self, position_ns: int) -> int | None:
        """Return the time at which a position is due; None while paused."""
        if self.paused:
            return None
        if self.rate == 0.0:
            return self._now_ns
        return self._now_ns + round((position_ns - self._position_ns) / self.rate)

    def change(self, now_ns: int, position_ns: int, *, rate: float | None = None, paused: bool | None = None) -> None:
        """Continue from a position at another rate, or pause; what is not given stays."""
        self._now_ns, self._position_ns = now_ns, position_ns
        self.rate = self.rate if rate is None else rate
        self.paused = self.paused if paused is None else paused

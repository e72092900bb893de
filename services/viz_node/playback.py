"""A recording as the source of a page, with a transport: play, pause, seek, rate."""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from services.viz_node.feed import SeenMessage
from services.viz_node.source import LOOP_TOPICS, is_shown
from telenano.recording.messages import RecordedChannel, RecordedMessage
from telenano.recording.multi_file import RecordingSource
from telenano.wire.errors import RecordingError, RefusedError

# Bounds of the rate of playback.
_LEAST_RATE = 0.01
_MOST_RATE = 100.0
_IMAGE_TOPIC = "afm/scanline"
# The first line of an image is first searched in this time before its last line [ns].
_LOOK_BACK_NS = 60_000_000_000
# Time before a sought place that is shown too, so that no curve begins empty [s].
_LEAD_S = 5.0
# Most messages in one call: a rate of 100 must not block the pages.
_MOST_MESSAGES = 20_000


class RecordingPlayback:
    """Plays the messages of a recording at their own rate, or another one.

    After a seek it first yields, from before that place, the newest message of each slow topic, the lines of the newest
    image, and the curves of a few seconds.
    """

    def __init__(self, recording: RecordingSource, monotonic_s: Callable[[], float]) -> None:
        """Start to play at the beginning; raise RecordingError if the recording has nothing to show."""
        self._recording = recording
        self._monotonic_s = monotonic_s
        self._start_ns, self._end_ns = recording.span_ns
        if not self._end_ns or not any(map(_is_shown, recording.channels)):
            raise RecordingError(f"{recording.path}: has none of the topics that the view shows")
        self._rate, self._playing, self._watched = 1.0, True, False
        self._restarted = False
        self._messages: Iterator[RecordedMessage] = iter(())
        self._waiting: RecordedMessage | None = None
        self._seek(0.0)
        self._restarted = False

    @property
    def position_s(self) -> float:
        """Position in the recording [s]; it does not advance while no page is open."""
        if not (self._playing and self._watched):
            return self._from_s
        elapsed_s = (self._monotonic_s() - self._from_monotonic_s) * self._rate
        return min(self._from_s + elapsed_s, self.length_s)

    @property
    def length_s(self) -> float:
        return (self._end_ns - self._start_ns) * 1e-9

    def poll(self, *, watched: bool) -> Iterator[SeenMessage]:
        if watched != self._watched:
            self._look(watched)
            return
        until_ns = self._start_ns + round(self.position_s * 1e9)
        for _ in range(_MOST_MESSAGES):
            message = self._waiting or next(self._messages, None)
            self._waiting = message
            if message is None or message.log_ns > until_ns:
                break
            self._waiting = None
            yield _seen(message)

    def take_restart(self) -> bool:
        restarted, self._restarted = self._restarted, False
        return restarted

    def about(self) -> Mapping[str, Any]:
        playing = self._playing and self.position_s < self.length_s
        return {
            "kind": "recording",
            "name": self._recording.path.name,
            "position_s": round(self.position_s, 1 if playing else 4),
            "length_s": self.length_s,
            "playing": playing,
            "rate": self._rate,
        }

    def transport(self, action: str, value: float) -> str:
        if not math.isfinite(value):
            raise RefusedError(f"{action}: a finite number is needed")
        if action == "seek":
            # A playback that has reached the end does not continue after a seek.
            self._playing = self._playing and self.position_s < self.length_s
            return self._seek(value)
        if action not in ("play", "pause", "rate"):
            raise RefusedError(f"{action}: unknown, the transport knows play, pause, seek and rate")
        place_s = self.position_s
        if action == "rate":
            if not _LEAST_RATE <= value <= _MOST_RATE:
                raise RefusedError(f"rate {value:g}: must be between {_LEAST_RATE:g} and {_MOST_RATE:g}")
            self._rate = value
        self._begin_at(place_s)
        if action == "play" and place_s >= self.length_s:
            self._seek(0.0)
        self._playing = action == "play" or (action == "rate" and self._playing)
        return {"play": "plays", "pause": "pauses", "rate": f"plays at {self._rate:g} times the pace"}[action]

    def close(self) -> None:
        """Do nothing: the file is open only while it is read."""

    def _look(self, watched: bool) -> None:
        """Pause when the last page closes; when one opens, continue there, or from the beginning after the end."""
        place_s = self.position_s
        self._watched = watched
        self._seek(0.0 if watched and place_s >= self.length_s else place_s)

    def _begin_at(self, place_s: float) -> None:
        self._from_s, self._from_monotonic_s = place_s, self._monotonic_s()

    def _seek(self, place_s: float) -> str:
        self._begin_at(min(max(place_s, 0.0), self.length_s))
        self._restarted = True
        lead_ns = self._start_ns + round(max(0.0, self._from_s - _LEAD_S) * 1e9)
        self._waiting = None
        self._messages = self._from(lead_ns)
        return f"at {self._from_s:.1f} s"

    def _from(self, start_ns: int) -> Iterator[RecordedMessage]:
        slow = self._recording.newest_before(
            start_ns, lambda found: _is_shown(found) and found.topic not in (*LOOP_TOPICS, _IMAGE_TOPIC)
        )
        before = sorted([*slow.values(), *self._image_before(start_ns)], key=lambda message: message.log_ns)
        yield from before
        yield from self._recording.select(_is_shown, start_ns)

    def _image_before(self, place_ns: int) -> list[RecordedMessage]:
        """Return the lines recorded before a place [ns] of the newest image that began before it.

        Its first line is searched in the minute before its newest line, and then in the whole earlier recording.
        """
        newest = self._recording.newest_before(place_ns, _is_image)
        if not newest:
            return []
        last_ns = max(line.log_ns for line in newest.values())
        lines: list[RecordedMessage] = []
        for first_ns in (max(last_ns - _LOOK_BACK_NS, self._start_ns), self._start_ns):
            lines, has_begun = [], False
            for line in self._recording.select(_is_image, first_ns, last_ns + 1):
                if _begins_image(line):
                    lines, has_begun = [], True
                lines.append(line)
            if has_begun:
                break
        return lines


def _is_image(channel: RecordedChannel) -> bool:
    return channel.topic == _IMAGE_TOPIC and channel.via == "direct"


def _begins_image(line: RecordedMessage) -> bool:
    fields = _seen(line).fields
    return fields.get("line") == 0 and fields.get("direction") == "trace"


def _is_shown(channel: RecordedChannel) -> bool:
    return is_shown(channel.topic) and channel.via == "direct"


def _seen(message: RecordedMessage) -> SeenMessage:
    try:
        return SeenMessage(message.topic, message.src, message.publish_ns, message.checked_fields())
    except RecordingError:
        # The feed counts a message without fields as unreadable.
        return SeenMessage(message.topic, message.src, message.publish_ns, {})

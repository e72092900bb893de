"""From frames on the bus to records in the file: what was heard, where, and what is missing."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import msgpack

from proto import MAX_MESSAGE_BYTES, TOPICS, Topic, WireError, decode
from proto.messages import SOURCE_PATTERN
from services.recorder.records import GapRecord, RejectedRecord
from services.recorder.writer import RecordingWriter, channel_topic
from services.runtime.bus import Received, Subscriber, split_frames
from services.runtime.errors import RecordingError
from services.runtime.sequence import Arrival, SequenceTracker
from services.runtime.site import site_of

_SOURCE = re.compile(SOURCE_PATTERN)
_LONGEST_SOURCE = 64
_LARGEST_COUNT = 2**63
_MOST_FRAMES_KEPT = 4


@dataclass(slots=True)
class Stream:
    """What one publisher says on one topic, heard at one place."""

    topic: Topic
    channel_topic: str
    src: str
    channel: int
    direct: bool
    tracker: SequenceTracker


@dataclass
class Listener:
    """The connection to one publisher: what comes through it was heard at that publisher's site."""

    publisher: str
    subscriber: Subscriber
    streams: dict[tuple[bytes, str], Stream] = field(default_factory=dict)


class Intake:
    """Records what it is given, and goes on without recording once the file cannot be written.

    `fault` then says why. Only the header of a message is looked at here: a message with a valid header is recorded
    as it came, whatever its fields.
    """

    def __init__(self, writer: RecordingWriter | None, fault: str = "") -> None:
        self.writer = writer
        self.fault = fault
        self.heard = 0
        self.gaps = 0
        self.lost = 0
        self.lossless_lost = 0
        self.rejected = 0

    def take(self, listener: Listener, frames: Sequence[bytes], received_ns: int) -> Received | None:
        """Record one message; a session/control heard at its publisher is also given back, decoded.

        Frames that are no message are counted with the subscriber and kept on the channel of the rejected.
        """
        self.heard += 1
        try:
            return self._take_message(listener, frames, received_ns)
        except WireError as error:
            self._reject(listener, frames, received_ns, error)
        except RecordingError as error:
            self._stop(error)
        return None

    def flush(self) -> None:
        """Make safe against a kill what was taken so far."""
        if self.writer is not None:
            try:
                self.writer.flush()
            except RecordingError as error:
                self._stop(error)

    def finish(self) -> None:
        """Complete the file."""
        if self.writer is not None:
            try:
                self.writer.finish()
            except RecordingError as error:
                self._stop(error)

    def _take_message(self, listener: Listener, frames: Sequence[bytes], received_ns: int) -> Received | None:
        topic, payload = split_frames(frames)
        row = TOPICS.get(topic)
        if row is None:
            raise WireError("topic", f"unknown topic {topic[:80]!r}")
        seq, t_ns, src = read_header(row, payload)
        stream = listener.streams.get((frames[0], src))
        if stream is None:
            stream = self._open_stream(listener, frames[0], row, src)
        arrival = stream.tracker.accept(seq, t_ns)
        if arrival is Arrival.AFTER_GAP:
            self._enter_gap(stream, received_ns)
        if self.writer is not None:
            self.writer.write(stream.channel, received_ns, t_ns, seq, payload)
        if topic == "session/control" and stream.direct and arrival is not Arrival.DUPLICATE:
            return Received(topic, decode(topic, payload), payload, received_ns, arrival)
        return None

    def _open_stream(self, listener: Listener, frame: bytes, row: Topic, src: str) -> Stream:
        site = site_of(listener.publisher)
        if not (_SOURCE.match(src) and len(src) <= _LONGEST_SOURCE):
            raise WireError("schema", f"{row.name}: src: {src[:80]!r} is not of the form node@site")
        tracker = listener.subscriber.tracker(row.name, src)
        channel = 0 if self.writer is None else self.writer.channel(row.name, src, site)
        stream = Stream(row, channel_topic(row.name, src, site), src, channel, site_of(src) == site, tracker)
        listener.streams[frame, src] = stream
        return stream

    def _enter_gap(self, stream: Stream, received_ns: int) -> None:
        first, last = stream.tracker.last_gap
        count = last - first + 1
        self.gaps += 1
        self.lost += count
        # what an impaired link drops on its way is the experiment, not a fault
        if stream.direct and stream.topic.delivery == "lossless":
            self.lossless_lost += count
        if self.writer is not None:
            gap = GapRecord(
                channel_topic=stream.channel_topic, src=stream.src, first_missing=first, last_missing=last, count=count
            )
            self.writer.write_gap(received_ns, gap)

    def _reject(self, listener: Listener, frames: Sequence[bytes], received_ns: int, error: WireError) -> None:
        subscriber = listener.subscriber
        subscriber.rejected[error.reason] = subscriber.rejected.get(error.reason, 0) + 1
        subscriber.last_error = str(error)
        self.rejected += 1
        if self.writer is None:
            return
        rejected = RejectedRecord(
            reason=error.reason,
            text=str(error)[:4096],
            publisher=listener.publisher,
            size_bytes=sum(map(len, frames)),
            frames=tuple(frame[:MAX_MESSAGE_BYTES] for frame in frames[:_MOST_FRAMES_KEPT]),
        )
        try:
            self.writer.write_rejected(received_ns, rejected)
        except RecordingError as fault:
            self._stop(fault)

    def _stop(self, error: RecordingError) -> None:
        self.writer = None
        self.fault = str(error)


def read_header(row: Topic, payload: bytes) -> tuple[int, int, str]:
    """Give seq, t_ns and src of a message without checking the rest of it.

    Raises WireError naming topic, key and what would be right. The form of `src` is left to the caller, who meets
    the same few again and again.
    """
    if len(payload) > MAX_MESSAGE_BYTES:
        raise WireError("oversized", f"{row.name}: {len(payload)} bytes, at most {MAX_MESSAGE_BYTES} are allowed")
    try:
        fields: dict[str, Any] = msgpack.unpackb(payload, use_list=False, max_ext_len=0)
    except (ValueError, msgpack.exceptions.UnpackException, RecursionError) as error:
        raise WireError("malformed", f"{row.name}: not msgpack: {str(error) or type(error).__name__}") from error
    if type(fields) is not dict:
        raise WireError("malformed", f"{row.name}: a msgpack {type(fields).__name__}, a map is needed")
    seq, t_ns, src, version = fields.get("seq"), fields.get("t_ns"), fields.get("src"), fields.get("v")
    if not (type(seq) is int and type(t_ns) is int and type(src) is str and type(version) is int):
        raise WireError("schema", f"{row.name}: the header needs seq, t_ns and v as integers and src as text")
    if version > row.model.version:
        text = f"{row.name}: schema version {version} is newer than version {row.model.version} known here"
        raise WireError("newer_version", text)
    if not (0 <= seq < _LARGEST_COUNT and 0 <= t_ns < _LARGEST_COUNT and version >= 1):
        raise WireError("schema", f"{row.name}: seq {seq}, t_ns {t_ns} or v {version} is out of range")
    return seq, t_ns, src

"""From frames on the bus to records in the file: what was heard, where, and what is missing."""

import contextlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import msgpack

from proto import MAX_MESSAGE_BYTES, TOPICS, Topic, WireError, decode
from proto.errors import RecordingError
from proto.messages import SOURCE_PATTERN
from proto.nodes import site_of
from proto.sequence import Arrival, SequenceTracker
from recording.channel_filter import ALL, Selection
from recording.records import GapRecord, RejectedRecord
from recording.writer import RecordingWriter, channel_topic
from services.recorder.rotation import FileRotation, QuotaError
from services.recorder.snapshot_buffer import Entry, Happened, SnapshotBuffer, trigger
from services.runtime.bus import Received, Subscriber, split_frames

_SOURCE = re.compile(SOURCE_PATTERN)
_LONGEST_SOURCE = 64
_LARGEST_COUNT = 2**63
_MOST_FRAMES_KEPT = 4
_NEVER = trigger(())


@dataclass(slots=True)
class Stream:
    """What one publisher says on one topic, heard at one place."""

    topic: Topic
    channel_topic: str
    src: str
    site: str
    channel: int | None
    direct: bool
    wanted: bool
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
    as it came, whatever its fields. With `parts` it begins new files on its own; with a ring as well it writes only
    from a trigger on, beginning with what the ring holds.
    """

    def __init__(
        self,
        writer: RecordingWriter | None,
        fault: str = "",
        *,
        selection: Selection = ALL,
        parts: FileRotation | None = None,
        ring: SnapshotBuffer | None = None,
        happened: Happened = _NEVER,
        after_s: float = 0.0,
    ) -> None:
        """Record into a writer; without one, and without a ring, nothing is recorded and `fault` says why."""
        self.writer = writer
        self.fault = fault
        self.heard = 0
        self.gaps = 0
        self.lost = 0
        self.lossless_lost = 0
        self.rejected = 0
        self.ring = ring
        self.parts = parts
        self.written = 0
        self._selection = selection
        self._happened = happened
        self._after_ns = round(after_s * 1e9)
        self._streams: list[Stream] = []
        self._triggered = False
        self._until_ns = 0

    @property
    def size_bytes(self) -> int:
        """Size of the file in hand up to the last flush [bytes]."""
        return 0 if self.writer is None else self.writer.size_bytes

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

    def flush(self, now_ns: int = 0) -> None:
        """Make safe against a kill what was taken so far; at `now_ns` begin and end files as is due."""
        try:
            if self.writer is not None:
                self.writer.flush()
            if self.parts is not None and not self.fault:
                self._turn_over(self.parts, now_ns)
        except RecordingError as error:
            self._stop(error)

    def split(self, now_ns: int) -> None:
        """Go on in a new file; RecordingError says why that cannot be."""
        if self.writer is None or self.parts is None:
            raise RecordingError(self.fault or "nothing is being written")
        self._next_part(self.parts, self.writer, now_ns)

    def snapshot(self) -> None:
        """Write what the ring holds, at the next flush at the latest; RecordingError when there is no ring."""
        if self.ring is None or self.fault:
            raise RecordingError(self.fault or "everything is written: there is no snapshot without snapshot_s")
        self._triggered = True

    def finish(self) -> None:
        """Complete the file."""
        if self.writer is not None:
            try:
                self.writer.finish()
            except RecordingError as error:
                self._stop(error)

    def _turn_over(self, parts: FileRotation, now_ns: int) -> None:
        if self._triggered and self.ring is not None:
            self._triggered = False
            self._until_ns = now_ns + self._after_ns
            if self.writer is None:
                self._write_ring(parts, self.ring, now_ns)
        elif self.writer is not None and self.ring is not None and now_ns >= self._until_ns:
            parts.finish(self.writer)
            self.writer = None
        if self.writer is not None and parts.due(self.writer, now_ns):
            self._next_part(parts, self.writer, now_ns)
        parts.keep_quota(self.writer)

    def _next_part(self, parts: FileRotation, writer: RecordingWriter, now_ns: int) -> None:
        parts.finish(writer)
        self.writer = None
        self._use(parts.begin(now_ns))

    def _use(self, writer: RecordingWriter) -> None:
        self.writer = writer
        # each file has numbers of its own for the channels
        for stream in self._streams:
            stream.channel = None

    def _write_ring(self, parts: FileRotation, ring: SnapshotBuffer, now_ns: int) -> None:
        self._use(parts.begin(now_ns))
        for entry in ring.take():
            self._store(entry)

    def _store(self, entry: Entry) -> None:
        writer = self.writer
        if writer is None:
            if self.ring is not None and not self.fault:
                self.ring.add(entry)
            return
        self.written += 1
        if isinstance(entry.record, GapRecord):
            writer.write_gap(entry.log_ns, entry.record)
        elif entry.record is not None:
            writer.write_rejected(entry.log_ns, entry.record)
        else:
            stream: Stream = entry.stream
            if stream.channel is None:
                stream.channel = writer.channel(stream.topic.name, stream.src, stream.site)
            writer.write(stream.channel, entry.log_ns, entry.publish_ns, entry.seq, entry.payload)

    def _take_message(self, listener: Listener, frames: Sequence[bytes], received_ns: int) -> Received | None:
        topic, payload = split_frames(frames)
        row = TOPICS.get(topic)
        if row is None:
            raise WireError("topic", f"unknown topic {topic[:80]!r}")
        fields = read_fields(row, payload)
        seq, t_ns, src = check_header(row, fields)
        permit = listener.subscriber.permit
        if permit is not None:
            permit(topic, src)
        stream = listener.streams.get((frames[0], src))
        if stream is None:
            stream = self._open_stream(listener, frames[0], row, src)
        arrival = stream.tracker.accept(seq, t_ns)
        if stream.wanted:
            if arrival is Arrival.AFTER_GAP:
                self._enter_gap(stream, received_ns)
            self._write(stream, received_ns, t_ns, seq, payload)
        if self.ring is not None and stream.direct and self._happened(topic, fields):
            self._triggered = True
        if topic == "session/control" and stream.direct and arrival is not Arrival.DUPLICATE:
            return Received(topic, decode(topic, payload), payload, received_ns, arrival)
        return None

    def _write(self, stream: Stream, received_ns: int, t_ns: int, seq: int, payload: bytes) -> None:
        # the common case without an entry, which would cost as much as the header
        if self.writer is not None and stream.channel is not None:
            self.written += 1
            self.writer.write(stream.channel, received_ns, t_ns, seq, payload)
        else:
            self._store(Entry(received_ns, t_ns, seq, payload, stream, None))

    def _open_stream(self, listener: Listener, frame: bytes, row: Topic, src: str) -> Stream:
        site = site_of(listener.publisher)
        if not (_SOURCE.match(src) and len(src) <= _LONGEST_SOURCE):
            raise WireError("schema", f"{row.name}: src: {src[:80]!r} is not of the form node@site")
        tracker = listener.subscriber.tracker(row.name, src)
        name = channel_topic(row.name, src, site)
        stream = Stream(row, name, src, site, None, site_of(src) == site, self._selection.names(name), tracker)
        listener.streams[frame, src] = stream
        self._streams.append(stream)
        return stream

    def _enter_gap(self, stream: Stream, received_ns: int) -> None:
        first, last = stream.tracker.last_gap
        count = last - first + 1
        self.gaps += 1
        self.lost += count
        # what an impaired link drops on its way is the experiment, not a fault
        if stream.direct and stream.topic.delivery == "lossless":
            self.lossless_lost += count
        gap = GapRecord(
            channel_topic=stream.channel_topic, src=stream.src, first_missing=first, last_missing=last, count=count
        )
        self._store(Entry(received_ns, received_ns, 0, b"", None, gap))

    def _reject(self, listener: Listener, frames: Sequence[bytes], received_ns: int, error: WireError) -> None:
        subscriber = listener.subscriber
        subscriber.rejected[error.reason] = subscriber.rejected.get(error.reason, 0) + 1
        subscriber.last_error = str(error)
        self.rejected += 1
        rejected = RejectedRecord(
            reason=error.reason,
            text=str(error)[:4096],
            publisher=listener.publisher,
            size_bytes=sum(map(len, frames)),
            frames=tuple(frame[:MAX_MESSAGE_BYTES] for frame in frames[:_MOST_FRAMES_KEPT]),
        )
        try:
            self._store(Entry(received_ns, received_ns, 0, b"".join(rejected.frames), None, rejected))
        except RecordingError as fault:
            self._stop(fault)

    def _stop(self, error: RecordingError) -> None:
        if isinstance(error, QuotaError) and self.writer is not None:
            # nothing is wrong with the file: it is completed, as far as the disk still allows
            with contextlib.suppress(RecordingError):
                self.writer.finish()
        self.writer = None
        self.fault = str(error)


def read_header(row: Topic, payload: bytes) -> tuple[int, int, str]:
    """Give seq, t_ns and src of a message without checking the rest of it.

    Raises WireError naming topic, key and what would be right. The form of `src` is left to the caller, who meets
    the same few again and again.
    """
    return check_header(row, read_fields(row, payload))


def read_fields(row: Topic, payload: bytes) -> dict[str, Any]:
    """Give the fields of a message unchecked; WireError names the topic when the bytes are no msgpack map."""
    if len(payload) > MAX_MESSAGE_BYTES:
        raise WireError("oversized", f"{row.name}: {len(payload)} bytes, at most {MAX_MESSAGE_BYTES} are allowed")
    try:
        fields: dict[str, Any] = msgpack.unpackb(payload, use_list=False, max_ext_len=0)
    except (ValueError, msgpack.exceptions.UnpackException, RecursionError) as error:
        raise WireError("malformed", f"{row.name}: not msgpack: {str(error) or type(error).__name__}") from error
    if type(fields) is not dict:
        raise WireError("malformed", f"{row.name}: a msgpack {type(fields).__name__}, a map is needed")
    return fields


def check_header(row: Topic, fields: dict[str, Any]) -> tuple[int, int, str]:
    """Give seq, t_ns and src; WireError names topic, key and what would be right."""
    seq, t_ns, src, version = fields.get("seq"), fields.get("t_ns"), fields.get("src"), fields.get("v")
    if not (type(seq) is int and type(t_ns) is int and type(src) is str and type(version) is int):
        raise WireError("schema", f"{row.name}: the header needs seq, t_ns and v as integers and src as text")
    if version > row.model.version:
        text = f"{row.name}: schema version {version} is newer than version {row.model.version} known here"
        raise WireError("newer_version", text)
    if not (0 <= seq < _LARGEST_COUNT and 0 <= t_ns < _LARGEST_COUNT and version >= 1):
        raise WireError("schema", f"{row.name}: seq {seq}, t_ns {t_ns} or v {version} is out of range")
    return seq, t_ns, src

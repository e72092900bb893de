"""Conversion of frames from the bus to records in the file: channel, header, gaps and rejected frames."""

import contextlib
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from services.recorder.rotation import FileRotation, QuotaError
from telenano.console.listener import Listener, Stream
from telenano.recording.channel_filter import ALL, Selection
from telenano.recording.disk import OWN_DISK, Disk
from telenano.recording.info import END_NAME
from telenano.recording.provenance import configuration_files, write_provenance
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.records import GapRecord, RejectedRecord
from telenano.recording.session_identity import SESSION_NAME, SESSION_VARIABLE, identity_entries
from telenano.recording.writer import FileEnd, RecordingWriter, channel_topic
from telenano.runtime.bus.bus import split_frames
from telenano.settings.package_topics import row_of
from telenano.timing.clock import Clock
from telenano.wire import TOPICS, decode
from telenano.wire.codec import MAX_MESSAGE_BYTES, WireError, fields_of, read_whole_header
from telenano.wire.ends import END_TOPIC, read_end
from telenano.wire.errors import RecordingError
from telenano.wire.messages import SOURCE_PATTERN
from telenano.wire.nodes import START_ORDER, begins_anew, name_of, site_of
from telenano.wire.received import Received
from telenano.wire.sequence import MOST_COUNTED, Arrival, total
from telenano.wire.topics import keep_unknown

# Messages on these topics are decoded; of all others only the header is read.
_DECODED = frozenset(("node/health", "session/control", END_TOPIC))
_SOURCE = re.compile(SOURCE_PATTERN)
_MAX_SOURCE_LENGTH = 64
_MAX_REJECTED_FRAMES = 4
# Looking up a member of an enumeration takes longer than a global, and is needed for every message.
_NEXT = Arrival.NEXT
_TOPIC_OF = {topic.encode(): topic for topic in TOPICS}
# A gap is recorded after this time, because messages that the link delivers late are not missing.
_LATE_NS = 100_000_000
# Nodes that are stopped before a recorder, and the silence after which they count as ended; they send far more often.
_SENDERS = tuple(node for node in START_ORDER if name_of(node) != "recorder")
_SILENT_NS = 500_000_000
# Interval of the attempts to continue on a disk that was full or could not be written.
_RETRY_NS = 1_000_000_000
# Most starts of a session that its files list, because an operator may start again and again.
_MOST_STARTS = 256
# Longer than any queue of messages delays; older stamps come from a replay.
_LONGEST_QUEUE_NS = 30_000_000_000


@dataclass
class _OpenGap:
    """A gap in the sequence numbers of a stream, and the numbers within it that came late."""

    stream: Stream
    first: int
    last: int
    noticed_ns: int
    came: set[int] = field(default_factory=set)

    def missing(self) -> Iterator[tuple[int, int]]:
        """Yield first and last number of each run that is still missing."""
        first = self.first
        for seq in (*sorted(self.came), self.last + 1):
            if seq > first:
                yield first, seq - 1
            first = seq + 1


class Intake:
    """Records messages; if the file cannot be written, it continues without recording and `fault` is the reason.

    Only the header of a message is validated: a message with a valid header is recorded unchanged. With `rotation` the
    intake begins new files by itself.

    `missing` counts the messages that were sent to the recorder and did not reach it; `notes` are sentences on other
    losses. Both are for the whole recording, not for one file.
    """

    def __init__(
        self,
        writer: RecordingWriter | None,
        fault: str = "",
        *,
        selection: Selection = ALL,
        rotation: FileRotation | None = None,
    ) -> None:
        """Record to a writer; None records nothing, for the reason `fault`."""
        self.writer = writer
        self.fault = fault
        # Whether commands are also accepted from the link: at the slave's site of two machines it is their only path.
        self.obeys_link = False
        self.received = 0
        self.gaps = 0
        self.lost = 0
        self.lossless_lost = 0
        self.missing = 0
        self.notes: list[str] = []
        self.rejected = 0
        self.rotation = rotation
        # Ids of the start commands received so far, for the further files of the session.
        self.starts: tuple[str, ...] = ()
        self.session: Mapping[str, str] = {}
        self.written = 0
        self.removed = 0
        self._selection = selection
        self._streams: list[Stream] = []
        # Publishers that announced their end and sent nothing since.
        self._ended: set[str] = set()
        # Nodes that a player replaces; it does not play their end messages.
        self._replayed: set[str] = set()
        self._open_gaps: list[_OpenGap] = []
        self._newest_ns = 0
        # Gaps of which the file has no record: since its last flush, and while none can be written.
        self._unflushed_gaps: list[GapRecord] = []
        self._untold: list[GapRecord] = []
        # Whether recording continues when the disk has room again; the times of the fault and of the next attempt [ns].
        self._goes_on = True
        self._stopped_ns = self._retry_ns = self._counted_unwritten = 0

    @property
    def size_bytes(self) -> int:
        """Size of the current file up to the last flush [bytes]."""
        return 0 if self.writer is None else self.writer.size_bytes

    def record(self, listener: Listener, frames: Sequence[bytes], received_ns: int) -> Received | None:
        """Record one message; return it decoded if it is a session/control received at its publisher, else None.

        With `obeys_link` commands from the link are also returned. Invalid frames are counted at the subscriber and
        recorded on `recorder/rejected`.
        """
        self.received += 1
        try:
            topic = _TOPIC_OF.get(frames[0]) if len(frames) == 2 else None
            if topic is None:
                topic, _ = split_frames(frames)
                if row_of(topic) is None:
                    keep_unknown(topic)
            payload = frames[1]
            seq, t_ns, src, run = read_whole_header(topic, payload)
            if (permit := listener.subscriber.permit) is not None:
                permit(topic, src)
            stream = listener.streams.get((topic, src))
            if stream is None:
                is_live = abs(received_ns - t_ns) < _LONGEST_QUEUE_NS
                stream = self._open_stream(listener, topic, src, seq, live=is_live)
            arrival = stream.tracker.accept(seq, t_ns, run)
            self._newest_ns = received_ns
            if stream.wanted:
                if arrival is not _NEXT:
                    self._note_arrival(stream, arrival, seq, received_ns)
                if self.writer is not None:
                    self.written += 1
                    channel = stream.channel or self._open_channel(self.writer, stream)
                    self.writer.write(channel, received_ns, t_ns, seq, payload)
            if self._ended and stream.direct:
                # A publisher that sends again was restarted.
                self._ended.discard(src)
            if topic in _DECODED:
                try:
                    message = decode(topic, payload)
                except WireError:
                    # An invalid message has been recorded unchanged, and has no effect.
                    return None
                self._interpret(listener, stream, fields_of(message), received_ns)
                if topic == "session/control" and (stream.direct or self.obeys_link):
                    return Received(topic, message, payload, received_ns, arrival)
        except WireError as error:
            self._reject(listener, frames, received_ns, error)
        except RecordingError as error:
            self._stop(error)
        return None

    def flush(self, now_ns: int = 0) -> None:
        """Flush the messages received so far, so that a kill loses none; at `now_ns` [ns] rotate files if due."""
        try:
            self._record_gaps(self._newest_ns - _LATE_NS)
            if self.writer is not None:
                self.writer.flush()
                self._note_kept()
                self._check_in_place(self.writer, now_ns)
            if self.rotation is not None and not self.fault:
                self._rotate(self.rotation, now_ns)
            elif self.rotation is not None and self._goes_on and now_ns >= self._retry_ns:
                self._retry_ns = now_ns + _RETRY_NS
                self._go_on(self.rotation, now_ns)
        except RecordingError as error:
            self._stop(error)

    def _note_kept(self) -> None:
        """Note that the file has all that was received so far, and that no fault of the disk takes it away."""
        self._unflushed_gaps.clear()
        for stream in self._streams:
            stream.kept = stream.tracker.last_seq

    def _go_on(self, rotation: FileRotation, now_ns: int) -> None:
        """Continue in a further file once the disk has room again, and record what is missing since the last flush."""
        if not rotation.has_room():
            return
        try:
            writer = rotation.begin(now_ns)
        except RecordingError as error:
            self.fault = str(error)
            return
        lasted = f"for {(self._newest_ns - self._stopped_ns) * 1e-9:.3f} s" if self._stopped_ns else "at first"
        note = f"nothing was recorded {lasted}: {self.fault}"
        unwritten = [
            (stream, first, last)
            for stream in self._streams
            for first, last in (*stream.unwritten, (stream.kept + 1, stream.tracker.last_seq))
            if first <= last and stream.wanted
        ]
        gaps = [*self._untold, *(_gap_of(*part) for part in unwritten)]
        try:
            # Write the notes now, in case the file is never finished.
            writer.add_metadata(END_NAME, {"state": "", "note": "; ".join([*self.notes, note])})
            self._use(writer)
            for gap in gaps:
                writer.write_gap(self._newest_ns, gap)
            writer.flush()
        except RecordingError as error:
            # The disk was full again at once, so all is still to be told.
            self.writer, self.fault = None, str(error)
            writer.discard()
            return
        self.fault = ""
        self.notes.append(note)
        self._untold.clear()
        self.written += len(gaps)
        self.gaps += len(unwritten)
        lost = total(last - first + 1 for _, first, last in unwritten) - self._counted_unwritten
        self._counted_unwritten = 0
        self.lost, self.missing = total((self.lost, lost)), total((self.missing, lost))
        for stream in self._streams:
            stream.unwritten.clear()
        self._note_kept()

    def split(self, now_ns: int) -> None:
        """Continue in a new file; raise RecordingError, with the reason, if that is not possible."""
        if self.writer is None or self.rotation is None:
            raise RecordingError(self.fault or "nothing is being written")
        self._record_gaps(self._newest_ns)
        # The command separates sessions, so the new file does not inherit the starts of the previous one.
        self.starts = ()
        self._next_file(self.rotation, self.writer, now_ns)

    def finish(self) -> None:
        try:
            self._record_gaps(self._newest_ns)
            if self.writer is not None:
                self.writer.finish(self._end("stopped"))
        except RecordingError as error:
            self._stop(error)

    def silent_at_the_end(self, sites: Sequence[str], now_ns: int) -> tuple[str, ...]:
        """Return the nodes at these sites that fell silent without an end message, so their last ones may be missing.

        A node that still sends is not included: the recorder ends before it. `now_ns` is by the clock of the stamps.
        """
        newest_ns: dict[str, int] = {}
        for stream in self._streams:
            if stream.live and stream.src in _SENDERS and site_of(stream.src) in sites:
                newest_ns[stream.src] = max(newest_ns.get(stream.src, 0), stream.tracker.last_t_ns)
        silent = {node for node, t_ns in newest_ns.items() if now_ns - t_ns > _SILENT_NS}
        return tuple(sorted(silent - self._ended - self._replayed))

    def _end(self, state: FileEnd | Literal[""]) -> dict[str, str]:
        return {"state": state, "note": "; ".join(self.notes)}

    def _check_in_place(self, writer: RecordingWriter, now_ns: int) -> None:
        """Continue in a new file if the current one was removed or replaced, which no write would notice."""
        if writer.in_place():
            return
        self.notes.append(f"{writer.path} was removed while it was written, and {writer.messages} messages with it")
        self.removed += 1
        self.writer = None
        writer.abandon()
        if self.rotation is None:
            raise RecordingError(self.notes[-1])
        following = self.rotation.begin(now_ns)
        # Write the notes now, in case the file is never finished.
        following.add_metadata(END_NAME, self._end(""))
        following.flush()
        self._use(following)

    def _rotate(self, rotation: FileRotation, now_ns: int) -> None:
        if self.writer is not None and rotation.due(self.writer, now_ns):
            self._next_file(rotation, self.writer, now_ns)
        rotation.keep_quota(self.writer)

    def _next_file(self, rotation: FileRotation, writer: RecordingWriter, now_ns: int) -> None:
        rotation.finish(writer, self._end("split"))
        self.writer = None
        self._use(rotation.begin(now_ns))

    def _note_start(self, command_id: str) -> None:
        """Add a start command to the session's identity in the file; it reaches both sites and so links their files."""
        # A simulation is reproducible and names its session by itself.
        if command_id in self.starts or not command_id or "simulated" in self.session.get("rig", ""):
            return
        self.starts = (*self.starts, "".join(command_id.split()))[-_MOST_STARTS:]
        if self.writer is not None:
            self._write_session(self.writer)

    def _write_session(self, writer: RecordingWriter) -> None:
        if self.starts and self.session:
            writer.add_metadata(SESSION_NAME, {**self.session, "starts": " ".join(self.starts)})

    def _use(self, writer: RecordingWriter) -> None:
        self.writer = writer
        self._write_session(writer)
        # Each file has its own channel numbers.
        for stream in self._streams:
            stream.channel = None

    def _open_channel(self, writer: RecordingWriter, stream: Stream) -> int:
        stream.channel = writer.channel(stream.topic.name, stream.src, stream.site)
        return stream.channel

    def _interpret(self, listener: Listener, stream: Stream, fields: Mapping[str, Any], received_ns: int) -> None:
        """Evaluate the messages that concern the recording: a replay, a start, the end of a publisher."""
        topic = stream.topic.name
        if topic == "node/health" and fields.get("replay") is True:
            self._replayed.add(stream.src)
        if topic == "session/control" and fields.get("command") == "start":
            self._note_start(str(fields.get("id", "")))
        if topic == END_TOPIC and stream.direct:
            self._compare_end(listener, fields, received_ns)

    def _open_stream(self, listener: Listener, topic: str, src: str, first: int, *, live: bool) -> Stream:
        row, site = TOPICS[topic], site_of(listener.publisher) or site_of(src)
        if not (_SOURCE.match(src) and len(src) <= _MAX_SOURCE_LENGTH):
            raise WireError("schema", f"{row.name}: src: {src[:80]!r} is not of the form node@site")
        tracker = listener.subscriber.tracker(row.name, src)
        tracker.counts_heads = not begins_anew(src)
        name = channel_topic(row.name, src, site)
        direct = site_of(src) == site
        wanted = self._selection.names(name)
        stream = Stream(row, name, src, site, None, direct, direct and live, wanted, tracker, first - 1)
        listener.streams[topic, src] = stream
        self._streams.append(stream)
        return stream

    def _compare_end(self, listener: Listener, fields: Mapping[str, Any], received_ns: int) -> None:
        """Compare the counts that a publisher announced at its end with the received messages."""
        sent = read_end(fields)
        if sent is None:
            return
        src = fields["src"]
        self._ended.add(src)
        for (name, source), count in sent.items():
            stream = listener.streams.get((name, source))
            is_own = source == src
            run = fields["run"] if is_own else None
            if stream is not None and stream.tracker.finish(count, run, ended=is_own) and stream.wanted:
                self._record_gaps(received_ns)
                first, last = stream.tracker.last_gap
                self._count_missing(stream, last - first + 1, at_end=True)
                self._write_gap(stream, first, last)

    def _note_arrival(self, stream: Stream, arrival: Arrival, seq: int, received_ns: int) -> None:
        if self.writer is None:
            # All since the last flush is missing, whatever arrived; until it is told, the gaps alone are counted.
            if arrival is Arrival.AFTER_GAP:
                first, last = stream.tracker.last_gap
                self._count_missing(stream, last - first + 1)
                self._counted_unwritten += last - first + 1
            elif arrival is Arrival.RESTART:
                stream.unwritten.append((stream.kept + 1, stream.tracker.left_seq))
                stream.kept = -1 if stream.tracker.lacks_head else seq - 1
        elif arrival is Arrival.AFTER_GAP:
            self._open_gap(stream, received_ns)
        elif arrival is Arrival.LATE:
            self._fill_gap(stream, seq)
        elif arrival is Arrival.RESTART:
            # The numbers of the process before end here. Recorded later, its gaps could be read as those of the new
            # one, whose numbers begin again.
            self._record_gaps(received_ns, stream)
            if stream.tracker.lacks_head:
                self._open_gap(stream, received_ns)

    def _open_gap(self, stream: Stream, received_ns: int) -> None:
        """Open a gap, which is recorded unless its messages arrive within `_LATE_NS`."""
        gap = _OpenGap(stream, *stream.tracker.last_gap, received_ns)
        self._open_gaps.append(gap)
        self._count_missing(stream, gap.last - gap.first + 1)

    def _fill_gap(self, stream: Stream, seq: int) -> None:
        """Remove a number that came late from its open gap."""
        for gap in reversed(self._open_gaps):
            if gap.stream is stream and gap.first <= seq <= gap.last:
                gap.came.add(seq)
                self._count_missing(stream, -1)
                return

    def _record_gaps(self, until_ns: int, of: Stream | None = None) -> None:
        """Record the missing numbers of the gaps that were noticed up to a time [ns], of one stream or of all."""
        gaps, self._open_gaps = self._open_gaps, []
        for gap in gaps:
            if gap.noticed_ns > until_ns or (of is not None and gap.stream is not of):
                self._open_gaps.append(gap)
                continue
            for first, last in gap.missing():
                self._write_gap(gap.stream, first, last)

    def _count_missing(self, stream: Stream, count: int, *, at_end: bool = False) -> None:
        self.lost = min(self.lost + count, MOST_COUNTED)
        # Losses on an impaired link are part of the experiment, except for messages that it had sent on at the end.
        if stream.direct or at_end:
            self.missing = min(self.missing + count, MOST_COUNTED)
        if stream.direct and stream.topic.delivery == "lossless":
            self.lossless_lost = min(self.lossless_lost + count, MOST_COUNTED)

    def _write_gap(self, stream: Stream, first: int, last: int) -> None:
        self.gaps += 1
        gap = _gap_of(stream, first, last)
        if self.writer is None:
            self._untold.append(gap)
        else:
            self.written += 1
            self._unflushed_gaps.append(gap)
            self.writer.write_gap(self._newest_ns, gap)

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
            frames=tuple(frame[:MAX_MESSAGE_BYTES] for frame in frames[:_MAX_REJECTED_FRAMES]),
        )
        try:
            if self.writer is not None:
                self.written += 1
                self.writer.write_rejected(received_ns, rejected)
        except RecordingError as fault:
            self._stop(fault)

    def _stop(self, error: RecordingError) -> None:
        writer, self.writer = self.writer, None
        self.fault = str(error)
        self._stopped_ns = self._newest_ns
        # What was written since the last flush is not in the file.
        self._untold += self._unflushed_gaps
        self._unflushed_gaps.clear()
        self._goes_on = not isinstance(error, QuotaError)
        if isinstance(error, QuotaError) and writer is not None:
            # The file itself is intact, so finish it as far as the disk allows.
            self.notes.append(f"the recording was stopped before its end: {error}")
            with contextlib.suppress(RecordingError):
                writer.finish(self._end("quota"))


def _gap_of(stream: Stream, first: int, last: int) -> GapRecord:
    return GapRecord(
        channel_topic=stream.channel_topic,
        src=stream.src,
        first_missing=first,
        last_missing=last,
        count=last - first + 1,
    )


def begin_recording(
    key: str,
    clock: Clock,
    config: RecorderConfig,
    site_file: Path,
    scenario_file: Path | None,
    disk: Disk = OWN_DISK,
    facts: Mapping[str, Mapping[str, str]] = MappingProxyType({}),
) -> Intake:
    """Start a recording by the node `key`; `facts` are further metadata records of each file, by name.

    If a file cannot be written, the intake reports a fault instead of raising an error, so that the rig continues.
    """
    try:
        files = configuration_files(site_file, scenario_file)
    except RecordingError as error:
        return Intake(None, str(error), selection=config.selection())

    scenario = files["scenario"].content if "scenario" in files else None
    given, simulated = os.environ.get(SESSION_VARIABLE, ""), facts.get("simulation", {})
    session = identity_entries(given, key, clock.now_ns(), scenario, simulated)
    recorded = {**facts, SESSION_NAME: session}

    def create_file(number: int) -> RecordingWriter:
        writer = RecordingWriter.create(key, config, number, disk)
        try:
            write_provenance(writer, config, files, clock.now_ns(), recorded)
        except RecordingError:
            writer.discard()
            raise
        return writer

    rotation = FileRotation(config, create_file, disk)
    writer, fault = None, ""
    try:
        writer = rotation.begin(clock.monotonic_ns())
    except RecordingError as error:
        fault = str(error)
    intake = Intake(writer, fault, selection=config.selection(), rotation=rotation)
    intake.session = session
    return intake

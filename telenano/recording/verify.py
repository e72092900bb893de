"""Check of a recording: is it complete, and if not, exactly which data are missing."""

import contextlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel

from telenano.recording.answered_commands import ANSWER_TOPIC, COMMAND_TOPIC, AnsweredCommands
from telenano.recording.info import finish_recorded, notes_of
from telenano.recording.mcap_scan import Damage, describe_damage
from telenano.recording.messages import RecordedChannel, RecordedMessage
from telenano.recording.multi_file import MultiFileRecording
from telenano.recording.reader import Recording
from telenano.recording.record_topics import GAP_TOPIC, RECORD_TOPICS
from telenano.recording.session_identity import one_session
from telenano.settings.known_packages import KNOWN_PACKAGES
from telenano.settings.package_topics import row_of
from telenano.wire.codec import fields_of, keys_twice, sound_header
from telenano.wire.ends import END_TOPIC, read_end
from telenano.wire.errors import RecordingError
from telenano.wire.extras import how_to_add_package
from telenano.wire.messages import Message
from telenano.wire.nodes import begins_anew
from telenano.wire.sequence import Arrival, SequenceTracker
from telenano.wire.topics import NAME

Check = Literal["crc", "order", "gap", "schema", "end", "index", "odd"]
Level = Literal["error", "warning", "info"]
_SEQUENCE_MASK = 0xFFFF_FFFF
# Most findings reported for each check and channel: a file that is wrong throughout needs no line for each message.
_MAX_REPORTED = 5


class Finding(BaseModel):
    """A finding; level `info` is no fault, such as messages that an impaired link dropped."""

    check: Check
    level: Level
    file: str
    channel: str
    text: str


class Verdict(BaseModel):
    """Result of a check: `sound` if no finding is above level `info`."""

    sound: bool
    messages: int
    findings: tuple[Finding, ...]


def verify(paths: Sequence[Path], *, same_session: bool = False) -> Verdict:
    """Check a recording; several files are treated as its parts, and messages missing between them are reported.

    Args:
        paths: The files.
        same_session: Whether to join files that do not state whether they belong to one session.

    Raises:
        RecordingError: A file is not a recording at all, or two are not of one session.
    """
    files = one_session([Recording(path) for path in paths], same_session=same_session)
    recordings = sorted(files, key=lambda recording: recording.span_ns)
    findings: list[Finding] = []
    total = 0
    between: list[Finding] = []
    trackers: dict[RecordedChannel, SequenceTracker] = {}
    # The last file with a message of each channel.
    newest: dict[RecordedChannel, Recording] = {}
    commands = AnsweredCommands()
    for recording in recordings:
        check = _Check(recording, trackers, commands)
        findings += check.run()
        total += check.messages
        between += _between(recording, check, newest)
        newest |= dict.fromkeys(check.begun(), recording)
    findings += between
    file = str(recordings[0].path) if recordings else ""
    findings += [
        Finding(check="gap", level="warning", file=file, channel=COMMAND_TOPIC, text=text)
        for text in commands.missing()
    ]
    findings += _cut(recordings)
    return Verdict(sound=all(finding.level == "info" for finding in findings), messages=total, findings=tuple(findings))


class _Stream:
    """State of a channel in a file: its tracker, which the files share, and the missing ranges.

    `begun`: whether the file has a message of it. `missing` has first and last missing seq, and the time at which each
    gap was noticed [ns]. `topic` selects the fast check of a payload; it is empty if each message needs the full check.
    """

    __slots__ = ("begun", "missing", "src", "topic", "tracker")

    def __init__(self, channel: RecordedChannel, tracker: SequenceTracker) -> None:
        self.tracker = tracker
        self.begun = False
        self.missing: list[tuple[int, int, int]] = []
        self.src = channel.src
        # End messages, commands and answers need the full check, because they are compared.
        self.topic = "" if channel.topic in (END_TOPIC, COMMAND_TOPIC) else channel.topic


class _Check:
    """The check of one file."""

    def __init__(
        self, recording: Recording, trackers: dict[RecordedChannel, SequenceTracker], commands: AnsweredCommands
    ) -> None:
        """Prepare the check of a file.

        Args:
            recording: The file.
            trackers: Those of the channels in the earlier files, which are continued.
            commands: Takes the commands and answers of the file.
        """
        # Channel, first and last seq of what is missing between this file and the earlier ones.
        self.between: list[tuple[RecordedChannel, int, int]] = []
        self._trackers = trackers
        self._commands = commands
        self._recording = recording
        self._findings: list[Finding] = []
        self._streams: dict[RecordedChannel, _Stream] = {}
        # Channel, first and last seq of gaps at the end of a publisher's messages.
        self._at_end: set[tuple[RecordedChannel, int, int]] = set()
        # Channel name, source, first and last seq of each gap that the recorder recorded.
        self._recorded_gaps: set[tuple[str, str, int, int]] = set()
        # Recorded gaps without a later message (first, last, time [ns]), by channel name and source.
        self._open_gaps: dict[tuple[str, str], tuple[int, int, int]] = {}
        self._reported: dict[tuple[str, str], int] = {}
        # Number of messages of each topic whose model is unknown.
        self._unknown: Counter[str] = Counter()

    def run(self) -> list[Finding]:
        damage: list[Damage] = list(self._recording.structural_damage)
        # Look up streams by the identity of the channel, which is one object in all its messages: hashing its fields
        # would take a third of the time. The channel is kept so that its id stays unique.
        kept: dict[int, tuple[_Stream, RecordedChannel]] = {}
        last_ns = count = 0
        for message in self._recording.select(report=damage.append):
            channel, log_ns, publish_ns, seq, payload = message
            decoder = kept.get(id(channel))
            if decoder is None:
                decoder = kept[id(channel)] = self._stream(channel), channel
            stream = decoder[0]
            tracker = stream.tracker
            count += 1
            if (
                log_ns >= last_ns
                and seq - 1 == tracker.last_seq
                and not tracker.ended
                and stream.begun
                and not self._open_gaps
                and stream.topic
                and sound_header(stream.topic, payload) == (seq, publish_ns, stream.src, tracker.run)
            ):
                tracker.accept(seq, publish_ns, tracker.run)
                last_ns = log_ns
            else:
                last_ns = self._check_message(message, stream, last_ns)
        self.messages = count
        for text in describe_damage(damage):
            self._report("crc", "error", "", text)
        for text in self._recording.odd:
            self._report("odd", "warning", "", text)
        for channel, newest in self._streams.items():
            gap = self._open_gaps.get((channel.channel_topic, channel.src))
            if gap is not None and gap[0] == newest.tracker.last_seq + 1:
                self._end_channel(channel, gap[1] + 1, gap[2])
        self._report_gaps()
        self._report_unknown()
        for note in notes_of((self._recording.metadata,)):
            self._report("end", "error", "", note)
        if not self._recording.closed:
            self._report("end", "error", "", self._end_text())
        elif not damage:
            for text in self._recording.index_faults(self.messages):
                self._report("index", "error", "", f"{text}; other readers may fail on it")
        return self._findings

    def begun(self) -> Iterator[RecordedChannel]:
        """Yield the channels of which the file has a message."""
        return (channel for channel, stream in self._streams.items() if stream.begun)

    def _stream(self, channel: RecordedChannel) -> _Stream:
        stream = self._streams.get(channel)
        if stream is None:
            tracker = self._trackers.setdefault(channel, SequenceTracker(counts_heads=not begins_anew(channel.src)))
            stream = self._streams[channel] = _Stream(channel, tracker)
        return stream

    def _check_message(self, message: RecordedMessage, stream: _Stream, last_ns: int) -> int:
        """Check one message; `last_ns` is the latest reception time so far [ns]; return the new latest one."""
        channel, log_ns = message.channel, message.log_ns
        if log_ns < last_ns:
            back_s = (last_ns - log_ns) * 1e-9
            text = f"seq {message.seq} is out of order by {back_s:.6f} s"
            self._report("order", "warning", channel.channel_topic, text)
        topic = channel.topic
        if topic in RECORD_TOPICS:
            record = self._check_schema(message)
            if topic == GAP_TOPIC and record is not None:
                self._add_gap_record(record, log_ns)
        else:
            if row_of(topic) is not None:
                decoded = self._check_schema(message)
                if decoded is not None and topic in (COMMAND_TOPIC, ANSWER_TOPIC):
                    self._commands.add(topic, fields_of(decoded))
            elif NAME.fullmatch(topic):
                self._unknown[topic] += 1
            self._check_sequence(message, stream)
            if topic == END_TOPIC and channel.via == "direct":
                self._check_end(message)
        return max(last_ns, log_ns)

    def _check_schema(self, message: RecordedMessage) -> Any:
        """Check a message against its model and its record; return the decoded message, None if invalid."""
        channel = message.channel
        try:
            decoded = message.decode()
        except RecordingError as error:
            self._report("schema", "error", channel.channel_topic, str(error))
            return None
        if not isinstance(decoded, Message):
            return decoded
        if twice := keys_twice(message.payload):
            text = f"seq {message.seq}: the key {twice[0]!r} occurs twice, and a reader takes the last"
            self._report("schema", "error", channel.channel_topic, text)
        header = decoded.seq & _SEQUENCE_MASK, decoded.t_ns, decoded.src
        stated = message.seq, message.publish_ns, channel.src
        if header != stated:
            pairs = zip(("seq", "t_ns", "src"), header, stated, strict=True)
            wrong = [name for name, of_message, of_record in pairs if of_message != of_record]
            text = f"seq {message.seq}: {', '.join(wrong)} in the record and in the message differ"
            self._report("schema", "error", channel.channel_topic, text)
        return decoded

    def _add_gap_record(self, record: Any, log_ns: int) -> None:
        first, last = record.first_missing & _SEQUENCE_MASK, record.last_missing & _SEQUENCE_MASK
        self._recorded_gaps.add((record.channel_topic, record.src, first, last))
        self._open_gaps[record.channel_topic, record.src] = (first, last, log_ns)

    def _check_end(self, message: RecordedMessage) -> None:
        """Compare the counts that a publisher announced at its end with the recorded messages."""
        try:
            sent, run = read_end(message.fields()) or {}, message.run
        except RecordingError:
            # The check of the schema has already reported the unreadable message.
            return
        for channel in list(self._trackers):
            # The counts hold for the publisher's own endpoint; other channels were received through other endpoints.
            is_own = channel.src == message.src
            if channel.site == message.site and (channel.via == "direct") == is_own:
                count = sent.get((channel.topic, channel.src))
                if count is not None:
                    self._end_channel(channel, count, message.log_ns, run if is_own else None, ended=is_own)

    def _end_channel(
        self, channel: RecordedChannel, sent: int, log_ns: int, run: int | None = None, *, ended: bool = True
    ) -> None:
        stream = self._stream(channel)
        if not stream.tracker.ended and finish_recorded(stream.tracker, sent, run, ended=ended):
            first, last = stream.tracker.last_gap
            stream.missing.append((first, last, log_ns))
            self._at_end.add((channel, first, last))

    def _check_sequence(self, message: RecordedMessage, newest: _Stream) -> None:
        channel, seq = message.channel, message.seq
        # A gap followed by a message is not at the end of the channel.
        if self._open_gaps:
            self._open_gaps.pop((channel.channel_topic, channel.src), None)
        tracker, begun, newest.begun = newest.tracker, newest.begun, True
        arrival = tracker.accept(seq, message.publish_ns, message.run)
        if arrival is Arrival.RESTART:
            self._report("gap", "info", message.channel_topic, f"{message.src} was restarted before seq {seq}")
        if arrival is Arrival.AFTER_GAP or (arrival is Arrival.RESTART and tracker.lacks_head):
            if begun:
                newest.missing.append((*tracker.last_gap, message.log_ns))
            else:
                self.between.append((channel, *tracker.last_gap))
        elif arrival is Arrival.LATE:
            self._remove_from_missing(newest.missing, seq)

    @staticmethod
    def _remove_from_missing(missing: list[tuple[int, int, int]], seq: int) -> None:
        """Remove the seq of a message that was overtaken from the missing ranges, of which the last ones are newest."""
        for place in reversed(range(len(missing))):
            first, last, log_ns = missing[place]
            if first <= seq <= last:
                parts = ((first, seq - 1, log_ns), (seq + 1, last, log_ns))
                missing[place : place + 1] = [part for part in parts if part[0] <= part[1]]
                return

    def _report_gaps(self) -> None:
        origin_ns = self._recording.span_ns[0]
        for channel, stream in self._streams.items():
            for first, last, log_ns in stream.missing:
                recorded = (channel.channel_topic, channel.src, first, last) in self._recorded_gaps
                how = "the recorder recorded the gap" if recorded else "there is no gap record"
                at_end = (channel, first, last) in self._at_end
                place = f"{(log_ns - origin_ns) * 1e-9:.6f} s after the start"
                place = f"at the end of what it sent, {place}" if at_end else place
                text = f"seq {first} to {last} of {channel.src} ({last - first + 1}) missing, {place}: {how}"
                # Losses on an impaired link are part of the experiment, not a fault.
                level: Level = "info" if channel.via == "link" and not at_end else "warning"
                self._report("gap", level, channel.channel_topic, text)

    def _report_unknown(self) -> None:
        """Report the topics of packages that are not installed, of which only the headers were checked."""
        for topic, count in self._unknown.items():
            package = KNOWN_PACKAGES.get(f"topic {topic}")
            advice = f"; install {package}: `{how_to_add_package(package)}`" if package else ""
            text = f"{count} messages of a topic that no installed package declares: only their headers were checked"
            self._report("schema", "info", topic, text + advice)

    def _end_text(self) -> str:
        interval = self._recording.metadata.get("recording", {}).get("recorder flush_interval_s")
        flush = f" ({interval} s)" if interval else ""
        end_s = (self._recording.span_ns[1] - self._recording.span_ns[0]) * 1e-9
        return (
            f"the file was not closed: it ends {end_s:.6f} s after its start, and what was sent then is not in it; how "
            f"much that is cannot be read from it: a killed recorder loses what came since its last flush{flush}, one "
            "whose disk is full any amount, and so does a file that was cut off"
        )

    def _report(self, check: Check, level: Level, channel: str, text: str) -> None:
        reported = self._reported.get((check, channel), 0)
        self._reported[check, channel] = reported + 1
        if reported == _MAX_REPORTED:
            text = f"more of this kind: only the first {_MAX_REPORTED} are reported"
        if reported <= _MAX_REPORTED:
            path = str(self._recording.path)
            self._findings.append(Finding(check=check, level=level, file=path, channel=channel, text=text))


def _cut(recordings: Sequence[Recording]) -> Iterator[Finding]:
    """Yield findings on missing parts at the two ends of the session, with the sentences of a report."""
    # Imported here because it needs NumPy, which a file without a session does not.
    from telenano.recording.silence import cut_off

    whole = recordings[0] if len(recordings) == 1 else MultiFileRecording(recordings)
    # Unreadable messages are reported by the check of each file.
    with contextlib.suppress(RecordingError):
        for text in cut_off(whole):
            yield Finding(check="end", level="warning", file=str(whole.path), channel="haptic/state", text=text)


def _between(later: Recording, check: _Check, newest: Mapping[RecordedChannel, Recording]) -> Iterator[Finding]:
    """Yield findings on messages missing between a file and the earlier ones, from their `seq`."""
    for channel, first, last in check.between:
        earlier = newest[channel]
        pause_s = (later.span_ns[0] - earlier.span_ns[1]) * 1e-9
        text = (
            f"seq {first} to {last} of {channel.src} ({last - first + 1}) missing "
            f"between {earlier.path.name} and this file, {pause_s:.6f} s apart"
        )
        yield Finding(check="gap", level="warning", file=str(later.path), channel=channel.channel_topic, text=text)

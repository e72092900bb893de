"""Check of a recording: whether it is complete, and what precisely is missing where it is not."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Literal

from pydantic import BaseModel

from proto import TOPICS
from proto.errors import RecordingError
from recording.mcap_scan import Damage, describe_damage
from recording.messages import RecordedChannel, RecordedMessage
from recording.reader import Recording
from recording.records import GAP_TOPIC, RECORDS

Check = Literal["crc", "order", "gap", "schema", "end"]
Level = Literal["error", "warning", "info"]
_SEQUENCE_MASK = 0xFFFF_FFFF
# of each kind and channel; a file that is wrong throughout does not need a line for every message
_MAX_REPORTED = 5


class Finding(BaseModel):
    """A finding; `info` is not a fault, such as what an impaired link dropped."""

    check: Check
    level: Level
    file: str
    channel: str
    text: str


class Verdict(BaseModel):
    """Result of a check: `sound` when there is nothing above info."""

    sound: bool
    messages: int
    findings: tuple[Finding, ...]


def verify(paths: Sequence[Path]) -> Verdict:
    """Check recordings; several are taken as the files of one, so that what is missing between them is reported.

    Raises RecordingError when a file is not a recording at all.
    """
    recordings = sorted((Recording(path) for path in paths), key=lambda recording: recording.span_ns)
    findings: list[Finding] = []
    total = 0
    ends: list[dict[RecordedChannel, tuple[int, int]]] = []
    for recording in recordings:
        check = _Check(recording)
        findings += check.run()
        total += check.messages
        ends.append(check.bounds)
    for (earlier, later), (before, after) in zip(pairwise(recordings), pairwise(ends), strict=True):
        findings += _between(earlier, later, before, after)
    return Verdict(sound=all(finding.level == "info" for finding in findings), messages=total, findings=tuple(findings))


class _LastMessage:
    """Newest message of a channel so far."""

    def __init__(self, first: RecordedMessage) -> None:
        self.seq = first.seq
        self.t_ns = first.publish_ns


class _Check:
    """The check of one file."""

    def __init__(self, recording: Recording) -> None:
        self.bounds: dict[RecordedChannel, tuple[int, int]] = {}
        self.messages = 0
        self._recording = recording
        self._findings: list[Finding] = []
        self._last: dict[RecordedChannel, _LastMessage] = {}
        self._missing: dict[RecordedChannel, dict[tuple[int, int], int]] = {}
        self._recorded_gaps: set[tuple[str, str, int, int]] = set()
        self._reported: dict[tuple[str, str], int] = {}
        self._last_ns = 0

    def run(self) -> list[Finding]:
        damage: list[Damage] = list(self._recording.structural_damage)
        for message in self._recording.select(report=damage.append):
            self.messages += 1
            self._check_message(message)
        for text in describe_damage(damage):
            self._report("crc", "error", "", text)
        self._report_gaps()
        if not self._recording.complete:
            self._report("end", "error", "", self._end_text())
        return self._findings

    def _check_message(self, message: RecordedMessage) -> None:
        if message.log_ns < self._last_ns:
            back_s = (self._last_ns - message.log_ns) * 1e-9
            self._report(
                "order", "warning", message.channel_topic, f"seq {message.seq} is out of order by {back_s:.6f} s"
            )
        self._last_ns = max(self._last_ns, message.log_ns)
        if message.topic in TOPICS or message.topic in RECORDS:
            self._check_schema(message)
        if message.topic in RECORDS:
            if message.topic == GAP_TOPIC:
                self._add_gap_record(message)
            return
        self._check_sequence(message)

    def _check_schema(self, message: RecordedMessage) -> None:
        try:
            decoded = message.decode()
        except RecordingError as error:
            self._report("schema", "error", message.channel_topic, str(error))
            return
        if message.topic in RECORDS:
            return
        header = decoded.__dict__
        facts = {"seq": header["seq"] & _SEQUENCE_MASK, "t_ns": header["t_ns"], "src": header["src"]}
        record = {"seq": message.seq, "t_ns": message.publish_ns, "src": message.src}
        wrong = [name for name in facts if facts[name] != record[name]]
        if wrong:
            text = f"seq {message.seq}: {', '.join(wrong)} in the record and in the message differ"
            self._report("schema", "error", message.channel_topic, text)

    def _add_gap_record(self, message: RecordedMessage) -> None:
        fields = message.fields()
        found = [str(fields.get(name)) for name in ("channel_topic", "src")]
        numbers = [int(fields.get(name, 0)) for name in ("first_missing", "last_missing")]
        self._recorded_gaps.add((found[0], found[1], numbers[0], numbers[1]))

    def _check_sequence(self, message: RecordedMessage) -> None:
        channel = message.channel
        first, last = self.bounds.get(channel, (message.seq, message.seq))
        self.bounds[channel] = (first, max(last, message.seq))
        newest = self._last.get(channel)
        if newest is None:
            self._last[channel] = _LastMessage(message)
            self._missing[channel] = {}
            return
        if message.seq > newest.seq:
            if message.seq > newest.seq + 1:
                self._missing[channel][newest.seq + 1, message.seq - 1] = message.log_ns
            newest.seq, newest.t_ns = message.seq, message.publish_ns
        elif message.publish_ns > newest.t_ns:
            # the publisher was restarted and counts anew
            newest.seq, newest.t_ns = message.seq, message.publish_ns
            self._report("gap", "info", message.channel_topic, f"{message.src} was restarted before seq {message.seq}")
        else:
            self._remove_from_missing(channel, message.seq)

    def _remove_from_missing(self, channel: RecordedChannel, seq: int) -> None:
        """Remove a message that was overtaken from what is missing."""
        for (first, last), log_ns in list(self._missing[channel].items()):
            if first <= seq <= last:
                del self._missing[channel][first, last]
                for part in ((first, seq - 1), (seq + 1, last)):
                    if part[0] <= part[1]:
                        self._missing[channel][part] = log_ns
                return

    def _report_gaps(self) -> None:
        origin_ns = self._recording.span_ns[0]
        for channel, gaps in self._missing.items():
            for (first, last), log_ns in gaps.items():
                recorded = (channel.channel_topic, channel.src, first, last) in self._recorded_gaps
                how = "the recorder recorded the gap" if recorded else "there is no gap record"
                place = f"{(log_ns - origin_ns) * 1e-9:.6f} s after the start"
                text = f"seq {first} to {last} of {channel.src} ({last - first + 1}) missing, {place}: {how}"
                # what an impaired link drops is the experiment
                level: Level = "info" if channel.via == "link" else "warning"
                self._report("gap", level, channel.channel_topic, text)

    def _end_text(self) -> str:
        facts = self._recording.metadata.get("recording", {})
        interval = facts.get("recorder flush_interval_s")
        limit = f", at most the last {interval} s" if interval else ""
        end_s = (self._recording.span_ns[1] - self._recording.span_ns[0]) * 1e-9
        return f"the file was not closed: it ends {end_s:.6f} s after its start, later messages are lost{limit}"

    def _report(self, check: Check, level: Level, channel: str, text: str) -> None:
        reported = self._reported.get((check, channel), 0)
        self._reported[check, channel] = reported + 1
        if reported == _MAX_REPORTED:
            text = f"more of this kind: only the first {_MAX_REPORTED} are reported"
        if reported <= _MAX_REPORTED:
            path = str(self._recording.path)
            self._findings.append(Finding(check=check, level=level, file=path, channel=channel, text=text))


def _between(
    earlier: Recording,
    later: Recording,
    before: dict[RecordedChannel, tuple[int, int]],
    after: dict[RecordedChannel, tuple[int, int]],
) -> Iterator[Finding]:
    """Yield what is missing between two files, by the `seq` of the messages."""
    pause_s = (later.span_ns[0] - earlier.span_ns[1]) * 1e-9
    for channel, (first, _) in after.items():
        last = before.get(channel, (0, first - 1))[1]
        if channel.topic in RECORDS or channel not in before or first <= last + 1:
            continue
        text = (
            f"seq {last + 1} to {first - 1} of {channel.src} ({first - last - 1}) missing "
            f"between {earlier.path.name} and this file, {pause_s:.6f} s apart"
        )
        yield Finding(check="gap", level="warning", file=str(later.path), channel=channel.channel_topic, text=text)

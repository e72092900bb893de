"""Summary of a recording: counts, rate and losses of each channel, missing messages, and the recorder's lag."""

from array import array
from collections.abc import Iterable, Mapping
from typing import Literal

from mcap.records import Attachment
from pydantic import BaseModel, ConfigDict

from telenano.recording.answered_commands import ANSWER_TOPIC, COMMAND_TOPIC, AnsweredCommands
from telenano.recording.messages import RecordedChannel, RecordedMessage
from telenano.recording.record_topics import GAP_TOPIC, RECORD_TOPICS
from telenano.wire.ends import END_TOPIC, read_end
from telenano.wire.errors import RecordingError
from telenano.wire.nodes import begins_anew
from telenano.wire.sequence import SequenceTracker, total

# The metadata record at the end of a file, in which the recorder says why it ended and which data it knows to miss.
END_NAME = "end"
# the sequence of an MCAP message has 32 bits
_SEQUENCE_MASK = 0xFFFF_FFFF
# Most lags kept for each source; at this limit every second one is dropped, again and again.
_MOST_LAGS = 1 << 18
# Most channels with missing messages that are named; further ones are counted.
_MOST_NAMED = 5


class _Info(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


class ChannelInfo(_Info):
    """Statistics of one channel; times are in ns of the recorder's clock, and `rate_hz` is measured from them.

    `size_bytes`, `repeated` and `restarts` are None in a summary made from the index, without reading the messages.
    """

    channel_topic: str
    topic: str
    src: str
    site: str
    via: str
    declared_rate_hz: float | None
    messages: int
    size_bytes: int | None
    rate_hz: float
    first_ns: int
    last_ns: int
    gaps: int
    lost: int
    repeated: int | None
    restarts: int | None


class AttachmentInfo(_Info):
    """An attachment: a file within the recording."""

    name: str
    media_type: str
    size_bytes: int


def attachments_of(records: Mapping[str, Attachment]) -> tuple[AttachmentInfo, ...]:
    """Return name, media type and size [bytes] of each attachment for a summary."""
    return tuple(
        AttachmentInfo(name=name, media_type=records_of_name.media_type, size_bytes=len(records_of_name.data))
        for name, records_of_name in records.items()
    )


class LagInfo(_Info):
    """Time from the sending of a message to its reception by the recorder [s], at the site of the recorder."""

    p50_s: float
    p99_s: float
    max_s: float


class PartInfo(_Info):
    """One file of a recording; `pause_s` is the gap without recorded messages after the previous file [s]."""

    path: str
    start_ns: int
    end_ns: int
    messages: int
    closed: bool
    pause_s: float


class RecordingInfo(_Info):
    """Summary of a recording, or of the parts of one.

    `complete`: True if no message sent to the recorder is missing; else `missing` has sentences on the losses.
    `closed`: True if each file was closed properly, with index and end mark. `lost`: number of missing messages,
    without those that an impaired link dropped. `skipped_bytes`: unusable bytes; `damage` says where and why. `odd`:
    sentences on oddities that are no loss, such as messages whose times are far from all others. `recorder_lag`: None
    if unknown. `basis`: `messages` if every message was read, `summary` if only the index of a closed file was, which
    does not reveal damaged messages (`telenano.recording.summary_section`). `path` is the first of `parts`; these are
    empty for a single file. `commands`: number of answered commands; `commands_by_answer`: of these, those whose own
    message did not reach the recorder, so that the recording has them in an answer that repeats them.
    """

    path: str
    size_bytes: int
    start_ns: int
    end_ns: int
    duration_s: float
    messages: int
    complete: bool
    basis: Literal["messages", "summary"] = "messages"
    missing: tuple[str, ...]
    lost: int
    commands: int = 0
    commands_by_answer: int = 0
    closed: bool
    recorder_lag: LagInfo | None
    skipped_bytes: int
    damage: tuple[str, ...]
    odd: tuple[str, ...]
    parts: tuple[PartInfo, ...]
    channels: tuple[ChannelInfo, ...]
    attachments: tuple[AttachmentInfo, ...]
    metadata: dict[str, dict[str, str]]


def finish_recorded(tracker: SequenceTracker, sent: int, run: int | None, *, ended: bool) -> int:
    """Do `tracker.finish` for numbers that a recording has modulo 2^32; return the number of missing messages."""
    beyond = (sent - 1 - tracker.last_seq) & _SEQUENCE_MASK
    missing = 0 if beyond > _SEQUENCE_MASK // 2 else beyond
    return tracker.finish(tracker.last_seq + 1 + missing, run, ended=ended)


class ChannelStatistics:
    """Running statistics of one channel."""

    def __init__(self, first: RecordedMessage) -> None:
        self.channel = first.channel
        self.first_ns = first.log_ns
        self.last_ns = first.log_ns
        self.messages = 0
        self.size_bytes = 0
        # Messages that the link had passed on and that are missing: at its end, or while nothing was recorded.
        self._missing_behind_link = 0
        self._tracker = SequenceTracker(counts_heads=not begins_anew(first.src))

    def add(self, message: RecordedMessage, *, after_pause: bool = False) -> None:
        """Add a message; `after_pause`: it is the first one after a time in which nothing was recorded."""
        self.messages += 1
        self.size_bytes += len(message.payload)
        self.last_ns = message.log_ns
        before = self._tracker.lost
        self._tracker.accept(message.seq, message.publish_ns, message.run)
        if after_pause:
            # While nothing was recorded, what the link passed on is missing as well.
            self._missing_behind_link += max(0, self._tracker.lost - before)

    def finish(self, sent: int, run: int | None = None, *, ended: bool = True) -> None:
        """Count the messages up to `sent` that are missing at the end; `ended`: their publisher itself has ended."""
        if not self._tracker.ended:
            self._missing_behind_link += finish_recorded(self._tracker, sent, run, ended=ended)

    def follows(self, first_missing: int) -> bool:
        """Return whether a sequence number is the next one after the newest message."""
        return self._tracker.last_seq + 1 == first_missing

    @property
    def missing(self) -> int:
        """Number of messages that were sent to the recorder and are missing; drops of an impaired link do not count."""
        return self._tracker.lost if self.channel.via == "direct" else self._missing_behind_link

    def info(self) -> ChannelInfo:
        channel, tracker = self.channel, self._tracker
        span_ns = self.last_ns - self.first_ns
        return ChannelInfo(
            channel_topic=channel.channel_topic,
            topic=channel.topic,
            src=channel.src,
            site=channel.site,
            via=channel.via,
            declared_rate_hz=channel.rate_hz,
            messages=self.messages,
            size_bytes=self.size_bytes,
            rate_hz=(self.messages - 1) * 1e9 / span_ns if span_ns > 0 else 0.0,
            first_ns=self.first_ns,
            last_ns=self.last_ns,
            gaps=tracker.gaps,
            lost=tracker.lost,
            repeated=tracker.late + tracker.duplicates,
            restarts=tracker.restarts,
        )


class RecordingStatistics:
    """Statistics of a recording, updated with each message in order of reception, file by file."""

    def __init__(self, recorder_site: str) -> None:
        """Measure the lag only at the recorder's site, where both times are of one clock; everywhere if it is empty."""
        self.channels: dict[RecordedChannel, ChannelStatistics] = {}
        self._site = recorder_site
        self._lags: dict[str, _Lags] = {}
        self._replayed: set[str] = set()
        # Whether messages are missing between the current file and those before it.
        self.lost_between = False
        # Channels of earlier files without a message in the current file yet.
        self._awaited: set[RecordedChannel] = set()
        self._after_pause = True
        # The last gap that the recorder recorded (first and last missing number), by channel and source.
        self._gaps: dict[tuple[str, str], tuple[int, int]] = {}
        self.commands = AnsweredCommands()

    def begin_file(self, *, after_pause: bool = True) -> None:
        """Begin the next file of the recording; `after_pause`: nothing was recorded since the end of the last one."""
        self.lost_between, self._awaited, self._after_pause = False, set(self.channels), after_pause

    def add(self, message: RecordedMessage) -> None:
        """Add a message."""
        channel = message.channel
        statistics = self.channels.get(channel)
        if statistics is None:
            statistics = self.channels[channel] = ChannelStatistics(message)
        if self._awaited and channel in self._awaited:
            self._awaited.discard(channel)
            before = statistics.missing
            statistics.add(message, after_pause=self._after_pause)
            self.lost_between = self.lost_between or statistics.missing > before
        else:
            statistics.add(message)
        # A gap followed by a message is not at the end of the channel, even if the publisher restarts its numbers.
        if self._gaps and channel.src:
            self._gaps.pop((channel.channel_topic, channel.src), None)
        if channel.topic in (COMMAND_TOPIC, ANSWER_TOPIC):
            self.commands.add(channel.topic, _fields(message))
        if channel.topic == GAP_TOPIC:
            self._add_gap(message)
        elif channel.via == "direct" and channel.src and channel.topic not in RECORD_TOPICS:
            if self._site in ("", channel.site):
                self._lags.setdefault(channel.src, _Lags()).add(message.log_ns - message.publish_ns)
            if channel.topic == END_TOPIC:
                self._add_end(message)
            elif channel.topic == "node/health" and _fields(message).get("replay") is True:
                self._replayed.add(channel.src)

    def finish(self) -> None:
        """Count the gaps that the recorder recorded at the end of channels whose publisher announced no end."""
        for (channel_topic, src), (first, last) in self._gaps.items():
            for channel, statistics in self.channels.items():
                if (channel.channel_topic, channel.src) == (channel_topic, src) and statistics.follows(first):
                    statistics.finish(last + 1)

    @property
    def lost(self) -> int:
        """Messages that were sent to the recorder and are missing."""
        return total(statistics.missing for statistics in self.channels.values())

    def missing(self) -> tuple[str, ...]:
        """Return a sentence for each channel that lacks messages; the last one counts the further channels."""
        counts = [(counts.missing, channel) for channel, counts in self.channels.items() if counts.missing > 0]
        counts.sort(key=lambda row: -row[0])
        named = [
            f"{count} messages of {channel.src or 'a source'} on {channel.channel_topic} are missing"
            for count, channel in counts[:_MOST_NAMED]
        ]
        rest = counts[_MOST_NAMED:]
        if rest:
            named.append(f"{total(count for count, _ in rest)} messages on {len(rest)} further channels are missing")
        return (*named, *self.commands.missing())

    def lag(self) -> LagInfo | None:
        """Return the recorder's lag, None if unknown; replayed nodes are left out because their stamps are old."""
        lags = [lag_s for src, lag_s in self._lags.items() if src not in self._replayed]
        if not lags:
            return None
        # Imported here because a summary from the index needs no lag and should not wait for the import.
        import numpy as np

        kept = np.concatenate([np.frombuffer(lag_s.kept, dtype=np.int64) for lag_s in lags])
        p50, p99 = np.percentile(kept, [50.0, 99.0])
        return LagInfo(p50_s=float(p50) * 1e-9, p99_s=float(p99) * 1e-9, max_s=max(lag_s.most for lag_s in lags) * 1e-9)

    def _add_gap(self, message: RecordedMessage) -> None:
        fields = _fields(message)
        first, last = fields.get("first_missing"), fields.get("last_missing")
        if type(first) is int and type(last) is int:
            key = str(fields.get("channel_topic")), str(fields.get("src"))
            self._gaps[key] = (first & _SEQUENCE_MASK, last & _SEQUENCE_MASK)

    def _add_end(self, message: RecordedMessage) -> None:
        sent, run = read_end(_fields(message)) or {}, message.run
        for channel, statistics in self.channels.items() if sent else ():
            # The counts hold for the publisher's own endpoint; other channels were received through other endpoints.
            if channel.site == message.site and (channel.via == "direct") == (channel.src == message.src):
                count = sent.get((channel.topic, channel.src))
                if count is not None:
                    own = channel.src == message.src
                    statistics.finish(count, run if own else None, ended=own)


class _Lags:
    """Lags of a source's messages [ns]; of too many, a sample evenly spread over the recording is kept."""

    def __init__(self) -> None:
        self.most = 0
        self.kept = array("q")
        self._step = 1
        self._count = 0

    def add(self, lag_ns: int) -> None:
        self.most = max(self.most, lag_ns)
        if self._count % self._step == 0:
            # The lag of a damaged file may exceed 64 bits.
            self.kept.append(max(-(2**62), min(lag_ns, 2**62)))
            if len(self.kept) >= _MOST_LAGS:
                self.kept = self.kept[::2]
                self._step *= 2
        self._count += 1


def unclosed_text(name: str, start_ns: int, end_ns: int) -> str:
    """Return a sentence on a file that was not closed, from the times of its first and last message [ns]."""
    return f"{name} was not closed: it ends {(end_ns - start_ns) * 1e-9:.3f} s after its start, the rest is missing"


def notes_of(metadata: Iterable[Mapping[str, Mapping[str, str]]]) -> tuple[str, ...]:
    """Return the recorder's own notes on missing data, without repetitions, from the metadata of its files."""
    notes = [note for record in metadata for note in record.get(END_NAME, {}).get("note", "").split("; ") if note]
    return tuple(dict.fromkeys(notes))


def _fields(message: RecordedMessage) -> Mapping[str, object]:
    try:
        return message.fields()
    except RecordingError:
        return {}

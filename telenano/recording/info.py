"""Summary of a recording: per channel its counts, rate and losses; what is missing; how late the recorder was."""

from array import array
from collections.abc import Iterable, Mapping
from typing import Literal

from mcap.records import Attachment
from pydantic import BaseModel, ConfigDict

from telenano.recording.messages import RecordedChannel, RecordedMessage
from telenano.recording.record_topics import GAP_TOPIC, RECORD_TOPICS
from telenano.wire.ends import END_TOPIC, read_end
from telenano.wire.errors import RecordingError
from telenano.wire.sequence import SequenceTracker, total

# the metadata record with which the recorder ends a file: why it ended, and what is known to be missing
END_NAME = "end"
# the sequence of an MCAP message has 32 bits
_SEQUENCE_MASK = 0xFFFF_FFFF
# lags kept of a source; of more, every second one is left out, again and again
_MOST_LAGS = 1 << 18
# channels that are named where messages are missing; the rest is counted
_MOST_NAMED = 5


class _Info(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


class ChannelInfo(_Info):
    """Statistics of one channel; times in ns on the recorder's clock, `rate_hz` as measured from them.

    `size_bytes`, `repeated` and `restarts` are None in a summary that was made without reading the messages.
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
    """Return what a summary says of attachments."""
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
    """One of the files of a recording; `pause_s` is the time since the one before in which nothing was recorded."""

    path: str
    start_ns: int
    end_ns: int
    messages: int
    closed: bool
    pause_s: float


class RecordingInfo(_Info):
    """Summary of a recording, or of the parts of one.

    `complete`: nothing that was sent to the recorder is missing; `missing` names what is, in sentences. `closed`: each
    file was closed properly, with index and end mark. `lost`: messages missing, without those that an impaired link has
    dropped. `skipped_bytes`: bytes that could not be used; `damage`: where and why. `odd`: sentences on what is odd
    although nothing is missing, such as messages whose times are far from those of all others. `recorder_lag`: None
    where it is unknown. `basis`: every message was read for it, or the index of a closed file, which says nothing of
    damaged messages (`telenano.recording.summary_section`). `path` is the first of several `parts`, which are empty
    where there is but one file.
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
    closed: bool
    recorder_lag: LagInfo | None
    skipped_bytes: int
    damage: tuple[str, ...]
    odd: tuple[str, ...]
    parts: tuple[PartInfo, ...]
    channels: tuple[ChannelInfo, ...]
    attachments: tuple[AttachmentInfo, ...]
    metadata: dict[str, dict[str, str]]


class ChannelStatistics:
    """Running statistics of one channel."""

    def __init__(self, first: RecordedMessage) -> None:
        self.channel = first.channel
        self.first_ns = first.log_ns
        self.last_ns = first.log_ns
        self.messages = 0
        self.size_bytes = 0
        # missing although the link had sent them on
        self.missing_at_end = 0
        self._tracker = SequenceTracker()

    def add(self, message: RecordedMessage) -> None:
        self.messages += 1
        self.size_bytes += len(message.payload)
        self.last_ns = message.log_ns
        self._tracker.accept(message.seq, message.publish_ns)

    def finish(self, sent: int) -> None:
        """Record that the publisher has ended after this number of messages."""
        if not self._tracker.ended:
            # both numbers are known modulo 2^32
            beyond = (sent - 1 - self._tracker.last_seq) & _SEQUENCE_MASK
            missing = 0 if beyond > _SEQUENCE_MASK // 2 else beyond
            self.missing_at_end += self._tracker.finish(self._tracker.last_seq + 1 + missing)

    def follows(self, first_missing: int) -> bool:
        """Return whether a number is the next after the newest message."""
        return self._tracker.last_seq + 1 == first_missing

    @property
    def missing(self) -> int:
        """Messages that were sent to the recorder and are not there: what an impaired link drops was not."""
        return self._tracker.lost if self.channel.via == "direct" else self.missing_at_end

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
    """The statistics of a recording, message by message in the order of reception; its parts one after the other."""

    def __init__(self, recorder_site: str) -> None:
        """Begin; the lag is measured at the site of the recorder, whose clock it is, or everywhere if that is empty."""
        self.channels: dict[RecordedChannel, ChannelStatistics] = {}
        self._site = recorder_site
        self._lags: dict[str, _Lags] = {}
        self._replayed: set[str] = set()
        # whether numbers are missing between the file that is read and those before it
        self.lost_between = False
        # channels of those files of which this one had no message yet
        self._awaited: set[RecordedChannel] = set()
        # by channel and source, the gap that the recorder has recorded last
        self._gaps: dict[tuple[str, str], tuple[int, int]] = {}

    def begin_file(self) -> None:
        """Begin the next file of the recording."""
        self.lost_between, self._awaited = False, set(self.channels)

    def add(self, message: RecordedMessage) -> None:
        """Add a message."""
        channel = message.channel
        statistics = self.channels.get(channel)
        if statistics is None:
            statistics = self.channels[channel] = ChannelStatistics(message)
        if self._awaited and channel in self._awaited:
            self._awaited.discard(channel)
            before = statistics.missing
            statistics.add(message)
            self.lost_between = self.lost_between or statistics.missing > before
        else:
            statistics.add(message)
        # a gap before a message is none at the end, whatever numbers the publisher begins with again
        if self._gaps and channel.src:
            self._gaps.pop((channel.channel_topic, channel.src), None)
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
        """Add what the recorder found missing at the end of channels, where it did not record why."""
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
        return tuple(named)

    def lag(self) -> LagInfo | None:
        """Return the lag of the recorder; replayed messages have stamps of another time and do not count."""
        lags = [lag_s for src, lag_s in self._lags.items() if src not in self._replayed]
        if not lags:
            return None
        # A summary by the index has no lag, and does not wait for this import.
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
        sent = read_end(_fields(message)) or {}
        for channel, statistics in self.channels.items() if sent else ():
            # the counts are of the publisher's own endpoint: what was received elsewhere came through others
            if channel.site == message.site and (channel.via == "direct") == (channel.src == message.src):
                count = sent.get((channel.topic, channel.src))
                if count is not None:
                    statistics.finish(count)


class _Lags:
    """Lags of the messages of a source [ns], evenly spread over the recording where there are many."""

    def __init__(self) -> None:
        self.most = 0
        self.kept = array("q")
        self._step = 1
        self._count = 0

    def add(self, lag_ns: int) -> None:
        self.most = max(self.most, lag_ns)
        if self._count % self._step == 0:
            # A file may have times beyond 64 bits.
            self.kept.append(max(-(2**62), min(lag_ns, 2**62)))
            if len(self.kept) >= _MOST_LAGS:
                self.kept = self.kept[::2]
                self._step *= 2
        self._count += 1


def unclosed_text(name: str, start_ns: int, end_ns: int) -> str:
    """Return a sentence on a file that was not closed, with the times of its first and last message [ns]."""
    return f"{name} was not closed: it ends {(end_ns - start_ns) * 1e-9:.3f} s after its start, the rest is missing"


def notes_of(metadata: Iterable[Mapping[str, Mapping[str, str]]]) -> tuple[str, ...]:
    """Return what the recorder itself noted as missing, from the metadata of its files."""
    notes = [note for record in metadata for note in record.get(END_NAME, {}).get("note", "").split("; ") if note]
    return tuple(dict.fromkeys(notes))


def _fields(message: RecordedMessage) -> Mapping[str, object]:
    try:
        return message.fields()
    except RecordingError:
        return {}

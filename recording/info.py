"""Summary of a recording: per channel its counts, rate and losses."""

from pydantic import BaseModel, ConfigDict

from proto.sequence import SequenceTracker
from recording.messages import RecordedMessage


class _Info(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="forbid")


class ChannelInfo(_Info):
    """Statistics of one channel; times in ns on the recorder's clock, `rate_hz` as measured from them."""

    channel_topic: str
    topic: str
    src: str
    site: str
    via: str
    declared_rate_hz: float | None
    messages: int
    size_bytes: int
    rate_hz: float
    first_ns: int
    last_ns: int
    gaps: int
    lost: int
    repeated: int
    restarts: int


class AttachmentInfo(_Info):
    """An attachment: a file within the recording."""

    name: str
    media_type: str
    size_bytes: int


class RecordingInfo(_Info):
    """Summary of a recording.

    `complete`: the file was closed properly. `skipped_bytes`: bytes that could not be used; `damage`: where and why.
    """

    path: str
    size_bytes: int
    start_ns: int
    end_ns: int
    duration_s: float
    messages: int
    complete: bool
    skipped_bytes: int
    damage: tuple[str, ...]
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
        self._tracker = SequenceTracker()

    def add(self, message: RecordedMessage) -> None:
        self.messages += 1
        self.size_bytes += len(message.payload)
        self.last_ns = message.log_ns
        self._tracker.accept(message.seq, message.publish_ns)

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

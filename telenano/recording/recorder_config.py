"""Settings of the recorder."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from telenano.recording.channel_filter import Selection
from telenano.recording.writer import FileSettings
from telenano.wire import TOPICS
from telenano.wire.ends import END_TOPIC
from telenano.wire.errors import ConfigError

_Size = Annotated[int, Field(ge=65_536, le=1 << 50)]


# Topics with at least this rate are bulk [Hz], and so are those with seldom but large messages.
_BULK_HZ = 100.0
_LARGE = ("node/journal", "afm/scanline")


def is_bulk(topic: str) -> bool:
    """Return whether a topic needs so much of the network between two machines that its own site records it."""
    return topic in _LARGE or (topic in TOPICS and (TOPICS[topic].rate_hz or 0.0) >= _BULK_HZ)


class RecorderConfig(FileSettings):
    """Settings of the recorder: channels, splits into files, quota, and the longest loss if it is killed."""

    flush_interval_s: Annotated[float, Field(ge=0.01, le=0.25)] = Field(
        default=0.2, description="Longest part lost if the recorder is killed [s], 0.01 to 0.25"
    )
    topics: tuple[str, ...] = Field(
        default=(), description="Record only these: globs of channel names, or /regular expressions/; none = all"
    )
    exclude: tuple[str, ...] = Field(default=(), description="Channels not to record, by the same patterns")
    far: Literal["fetch", "stream"] = Field(
        default="stream",
        description="How the fast topics of the other machine are recorded: stream them over the network, or fetch "
        "them from there after the session, the default of `up --site`",
    )
    fetch_kbit_per_s: Annotated[float, Field(ge=64.0, le=1e6)] = Field(
        default=50_000.0, description="Rate of the fetch after a session, while no loop runs [kbit/s]"
    )
    split_size_bytes: _Size | None = Field(
        default=None, description="Begin a new file at this size [bytes]; none = never"
    )
    split_interval_s: Annotated[float, Field(ge=1.0, le=86_400.0)] | None = Field(
        default=None, description="Begin a new file after this time [s], 1 to 86400; none = never"
    )
    quota_bytes: _Size | None = Field(
        default=None, description="Greatest total size of the files of this recording [bytes]; none = no limit"
    )
    quota_policy: Literal["stop", "drop_oldest"] = Field(
        default="stop", description="At the quota: stop recording, or remove the oldest file of this recording"
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        try:
            self.selection()
        except ConfigError as error:
            raise ValueError(str(error)) from error
        splits = self.split_size_bytes is not None or self.split_interval_s is not None
        if self.quota_bytes is not None and self.quota_policy == "drop_oldest" and not splits:
            raise ValueError(
                "quota_policy drop_oldest removes complete files: it needs split_size_bytes or split_interval_s"
            )
        if self.quota_bytes is not None and (self.split_size_bytes or 0) > self.quota_bytes:
            raise ValueError(f"split_size_bytes must not be above quota_bytes, which is {self.quota_bytes}")
        return self

    def selection(self) -> Selection:
        return Selection.of(self.topics, self.exclude)

    def subscribes(self, topic: str, site: str) -> bool:
        """Return whether the recorder needs a bus topic at a site: to record it, or for commands and ends."""
        selection = self.selection()
        return topic in ("session/control", END_TOPIC) or selection.names(topic) or selection.names(f"{topic}@{site}")

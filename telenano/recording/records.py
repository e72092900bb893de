"""Records that the recorder itself writes into a recording, on channels of its own."""

from typing import Annotated

from pydantic import Field

from telenano.recording.record_topics import GAP_TOPIC as GAP_TOPIC
from telenano.recording.record_topics import REJECTED_TOPIC as REJECTED_TOPIC
from telenano.wire.messages import Count, Record, Source, Text


class GapRecord(Record):
    """Messages that the recorder should have received shortly before this point and did not.

    One that arrives within a tenth of a second, overtaken on its way, is recorded where it arrives and is not missing.
    """

    channel_topic: Text = Field(description="Channel on which messages are missing")
    src: Source = Field(description="Their publisher, node@site")
    first_missing: Count = Field(description="Lowest seq that is missing")
    last_missing: Count = Field(description="Highest seq that is missing")
    count: Annotated[int, Field(ge=1)] = Field(description="Number of messages missing")


class RejectedRecord(Record):
    """Frames that are not a message of this version of the wire, kept for whoever looks for the reason."""

    reason: Text = Field(description="One word for the reason: frames, topic, oversized, malformed, newer_version, ...")
    text: Text = Field(description="The same in a sentence")
    publisher: Text = Field(description="Node at whose endpoint the frames were received")
    size_bytes: Count = Field(description="Size of all frames together [bytes]")
    frames: tuple[bytes, ...] = Field(description="The first frames as they came, each cut at 1 MiB")


RECORDS: dict[str, type[Record]] = {GAP_TOPIC: GapRecord, REJECTED_TOPIC: RejectedRecord}

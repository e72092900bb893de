"""Records that the recorder itself writes into a recording, on channels of its own."""

from typing import Annotated

from telenano.recording.record_topics import GAP_TOPIC as GAP_TOPIC
from telenano.recording.record_topics import REJECTED_TOPIC as REJECTED_TOPIC
from telenano.wire.messages import Count, Record, Source, Text, about


class GapRecord(Record):
    """Messages that the recorder should have received shortly before this point and did not.

    A message that was overtaken in transit but arrives within 0.1 s is recorded where it arrives, and is not missing.
    """

    channel_topic: Annotated[Text, about("Channel on which messages are missing")]
    src: Annotated[Source, about("Their publisher, node@site")]
    first_missing: Annotated[Count, about("Lowest seq that is missing")]
    last_missing: Annotated[Count, about("Highest seq that is missing")]
    count: Annotated[int, about("Number of messages missing", ge=1)]


class RejectedRecord(Record):
    """Frames that are not a message of this version of the wire, kept for a person who looks for the reason."""

    reason: Annotated[Text, about("One word for the reason: frames, topic, oversized, malformed, newer_version, ...")]
    text: Annotated[Text, about("The same in a sentence")]
    publisher: Annotated[Text, about("Node at whose endpoint the frames were received")]
    size_bytes: Annotated[Count, about("Size of all frames together [bytes]")]
    frames: Annotated[tuple[bytes, ...], about("The first frames as they came, each cut at 1 MiB")]


RECORDS: dict[str, type[Record]] = {GAP_TOPIC: GapRecord, REJECTED_TOPIC: RejectedRecord}

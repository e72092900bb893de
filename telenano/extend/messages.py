"""Messages of the bus as a bridge, an export or its test has them: models, topics with their units, and records."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import proto
from proto import TOPICS as TOPICS
from proto import Message as Message
from proto import decode as decode
from proto import encode as encode
from proto.errors import RecordingError as RecordingError
from proto.nodes import site_of
from recording.messages import RecordedChannel as RecordedChannel
from recording.messages import RecordedMessage as RecordedMessage
from recording.quantities import quantity as quantity
from recording.tables import plain as plain
from recording.writer import channel_topic


def example(topic: str, **fields: Any) -> Message:
    """Return a message of a topic as the contract of the wire has it, with some fields changed; KeyError if unknown."""
    base = decode(topic, _golden()[topic])
    return type(base)(**(base.__dict__ | fields))


@cache
def _golden() -> dict[str, bytes]:
    vectors = json.loads((Path(proto.__file__).parent / "golden" / "vectors.json").read_text(encoding="utf-8"))
    return {vector["topic"]: bytes.fromhex(vector["hex"]) for vector in vectors if vector["case"] == "minimal"}


def recorded(topic: str, message: Message, log_ns: int, site: str = "") -> RecordedMessage:
    """Return a message as a recording or a running rig gives it.

    Args:
        topic: The topic of the message.
        message: The message.
        log_ns: When it was received [ns since 1970].
        site: The site at which it was received; empty for that of its publisher, else it is a copy that left the link.
    """
    row, site = TOPICS[topic], site or site_of(message.src)
    via, name = "direct" if site == site_of(message.src) else "link", channel_topic(topic, message.src, site)
    channel = RecordedChannel(name, topic, site, via, message.src, row.rate_hz, row.delivery)
    return RecordedMessage(channel, log_ns, message.t_ns, message.seq, encode(message))

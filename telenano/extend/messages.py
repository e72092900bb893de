"""Messages of the bus as a bridge, an export or its test has them: models, topics with their units, and records."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from telenano.recording.messages import RecordedChannel as RecordedChannel
from telenano.recording.messages import RecordedMessage as RecordedMessage
from telenano.recording.quantities import quantity as quantity
from telenano.recording.tables import plain as plain
from telenano.recording.writer import channel_topic
from telenano.wire import TOPICS as TOPICS
from telenano.wire import Message as Message
from telenano.wire import decode as decode
from telenano.wire import encode as encode
from telenano.wire.codec import keys_twice as keys_twice
from telenano.wire.errors import RecordingError as RecordingError
from telenano.wire.faults import Fault as Fault
from telenano.wire.faults import faults_of as faults_of
from telenano.wire.nodes import site_of


def example(topic: str, **fields: Any) -> Message:
    """Return a message of a topic as the contract of the wire has it, with some fields changed; KeyError if unknown."""
    base = decode(topic, bytes.fromhex(_examples()[topic]))
    return type(base)(**(msgspec.structs.asdict(base) | fields))


def required_keys(topic: str) -> set[str]:
    """Return the keys that every message of a topic has; KeyError if the topic is unknown."""
    return {field.name for field in msgspec.structs.fields(TOPICS[topic].model) if field.required}


@cache
def _examples() -> dict[str, str]:
    # These are the golden vectors of the case `minimal`; an installation does not have the others.
    return dict(json.loads((Path(__file__).parents[1] / "wire" / "examples.json").read_text(encoding="utf-8")))


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

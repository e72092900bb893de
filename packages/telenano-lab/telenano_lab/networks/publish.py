"""Publish messages instead of a node that does not run, for trials: `telenano topic pub`."""

import time
from typing import Any

import msgspec

from telenano.runtime import AddressBook, Participant
from telenano.settings import flag_overrides
from telenano.wire import TOPICS, ConfigError, Message

# The time that readers need to connect to a new endpoint [s].
_CONNECT_S = 0.5
_HEADER = set(Message.__struct_fields__)


def publish(book: AddressBook, src: str, topic: str, text: str, rate_hz: float, count: int | None) -> int:
    """Publish a message repeatedly, up to a number of times or until Ctrl-C; return the number sent.

    Args:
        book: The addresses of the rig.
        src: The publisher as node@site, whose endpoint is used.
        topic: The topic.
        text: The fields as YAML.
        rate_hz: The rate of the messages [Hz].
        count: The number of messages; None continues until Ctrl-C.

    Raises:
        ConfigError: A field is wrong, or `src` does not publish the topic; the message names the publishers.
        EndpointError: The node itself is running.
    """
    row = TOPICS[topic]
    if not row.is_published_by(src):
        publishers = ", ".join(row.publishers)
        raise ConfigError(f"{topic}: {src} does not publish it, {publishers} does: give --as")
    fields: Any = flag_overrides([f"fields={text}"])["fields"]
    if not isinstance(fields, dict):
        raise ConfigError(f"{topic}: the fields must be a mapping, such as {{force_n: [0, 0, -0.5]}}")
    declared = msgspec.structs.fields(row.model)
    unknown = sorted(set(fields) - {field.name for field in declared})
    missing = sorted({field.name for field in declared if field.required} - set(fields) - _HEADER)
    if unknown or missing:
        words = [f"unknown: {', '.join(unknown)}"] * bool(unknown) + [f"missing: {', '.join(missing)}"] * bool(missing)
        raise ConfigError(f"{topic}: {'; '.join(words)}; `telenano topic info {topic}` lists the fields")
    sent = 0
    with Participant.open(src, book) as participant:
        publisher = participant.bind(src)
        time.sleep(_CONNECT_S)
        try:
            while count is None or sent < count:
                publisher.publish(topic, **fields)
                sent += 1
                if count is None or sent < count:
                    time.sleep(1.0 / rate_hz)
        except KeyboardInterrupt:
            pass
    return sent

"""Messages for tests, with given number, time and values: of any topic, of the hand, and as in a recording."""

from typing import Any

import msgspec

from telenano.recording import RecordedMessage, recorded
from telenano.testing.filled_messages import examples
from telenano.wire import TOPICS, Message, encode, example
from telenano.wire.codec import fields_of as fields_of_message

_MS = 1_000_000
# Time of sending of the message with number 0 [ns since 1970]; each one is sent a millisecond after the previous one.
EPOCH_NS = 1_750_000_000_000_000_000


def numbered(topic: str, seq: int, **changes: Any) -> Message:
    """Return an example message of a topic with this number and its time of sending; `changes` replace fields."""
    return example(topic, **({"seq": seq, "t_ns": EPOCH_NS + seq * _MS} | changes))


def hand_state(seq: int, **changes: Any) -> Message:
    """Return a numbered `haptic/state`, whose position and force differ for each of ten thousand numbers.

    After these they repeat, because a test that publishes for long must stay within the ranges of the wire.
    """
    place = seq % 10_000
    fields = {"position_m": (0.0, 0.0, -1e-3 * place), "operator_force_n": (0.1, 0.2, -0.5 - place)}
    return numbered("haptic/state", seq, **({"src": "haptic_node@master", "limited": seq % 2 == 1} | fields | changes))


def fields_of(topic: str, **changes: Any) -> dict[str, Any]:
    """Return the fields of an example message without its header, for `publish`; `changes` replace fields."""
    required = {field.name for field in msgspec.structs.fields(TOPICS[topic].model) if field.required}
    found = fields_of_message(example(topic))
    present = {name: value for name, value in found.items() if value is not None or name in required}
    return {name: value for name, value in (present | changes).items() if name not in ("seq", "t_ns", "src", "v")}


def payload(topic: str, src: str, seq: int) -> bytes:
    """Return the encoded ordinary example of a topic, with the given source and number."""
    return encode(msgspec.structs.replace(examples(TOPICS[topic])["ordinary"], src=src, seq=seq))


def received(topic: str, message: Message, number: int, site: str = "") -> RecordedMessage:
    """Return a message as received `number` milliseconds after `EPOCH_NS`; for `site` see `messages.recorded`."""
    return recorded(topic, message, EPOCH_NS + number * _MS, site)

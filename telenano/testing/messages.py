"""Messages with a number, a time and values of choice: of a topic, of the hand, and as a recording has them."""

from typing import Any

import msgspec

from telenano.recording import RecordedMessage, recorded
from telenano.testing.filled_messages import examples
from telenano.wire import TOPICS, Message, encode, example
from telenano.wire.codec import fields_of as fields_of_message

_MS = 1_000_000
# when the message with the number 0 was sent [ns since 1970]; each is sent a millisecond after the one before
EPOCH_NS = 1_750_000_000_000_000_000


def numbered(topic: str, seq: int, **changes: Any) -> Message:
    """Return an example of a message with this number and its time of sending, with some fields changed."""
    return example(topic, **({"seq": seq, "t_ns": EPOCH_NS + seq * _MS} | changes))


def hand_state(seq: int, **changes: Any) -> Message:
    """Return a numbered `haptic/state`, whose place and force are others with each of ten thousand numbers.

    They begin anew then, because a test that publishes for long has to stay within the ranges of the wire.
    """
    place = seq % 10_000
    fields = {"position_m": (0.0, 0.0, -1e-3 * place), "operator_force_n": (0.1, 0.2, -0.5 - place)}
    return numbered("haptic/state", seq, **({"src": "haptic_node@master", "limited": seq % 2 == 1} | fields | changes))


def fields_of(topic: str, **changes: Any) -> dict[str, Any]:
    """Return the fields of an example of a message without its header, with some changed, to publish it."""
    required = {field.name for field in msgspec.structs.fields(TOPICS[topic].model) if field.required}
    found = fields_of_message(example(topic))
    present = {name: value for name, value in found.items() if value is not None or name in required}
    return {name: value for name, value in (present | changes).items() if name not in ("seq", "t_ns", "src", "v")}


def payload(topic: str, src: str, seq: int) -> bytes:
    """Return an ordinary message of a source with a number, as it is on the wire."""
    return encode(msgspec.structs.replace(examples(TOPICS[topic])["ordinary"], src=src, seq=seq))


def received(topic: str, message: Message, number: int, site: str = "") -> RecordedMessage:
    """Return a message as received `number` milliseconds after `EPOCH_NS`; for `site` see `messages.recorded`."""
    return recorded(topic, message, EPOCH_NS + number * _MS, site)

"""Encoding and decoding of messages.

A message is one msgpack map with a string key a field. Any bytes decode to a message or raise one `WireError`.
"""

from typing import Any, Literal

import msgpack
from pydantic import ValidationError

from proto.messages import MAX_ITEMS, MAX_KEYS, Message
from proto.topics import TOPICS, Topic

MAX_MESSAGE_BYTES = 1 << 20
_COUNT_LIMIT = 2**63

Reason = Literal["frames", "topic", "oversized", "malformed", "newer_version", "schema", "source", "role"]


class WireError(ValueError):
    """Bytes that are not a message; `reason` is one of a few words that can be counted."""

    def __init__(self, reason: Reason, text: str) -> None:
        super().__init__(text)
        self.reason: Reason = reason


def encode(message: Message) -> bytes:
    """Return the msgpack bytes of a message.

    Raises WireError (`oversized`) above MAX_MESSAGE_BYTES, so that the publisher gets the error and not every reader,
    and (`malformed`) for text that is not Unicode or an integer beyond 64 bits.
    """
    fields = message.__dict__
    if message.additions:
        fields = {key: value for key, value in fields.items() if value is not None or key not in message.additions}
    try:
        payload: bytes = msgpack.packb(fields, default=_fields_of)
    except (TypeError, ValueError, OverflowError) as error:
        raise WireError("malformed", f"{type(message).__name__} cannot be sent: {error}") from error
    if len(payload) > MAX_MESSAGE_BYTES:
        raise WireError("oversized", _size_text(type(message).__name__, len(payload)))
    return payload


def decode(topic: str, payload: bytes) -> Message:
    """Return the message that `payload` holds on `topic`.

    Raises WireError naming the topic, the key at fault and what would be right.
    """
    row, fields = _read(topic, payload)
    try:
        return row.model.model_validate(fields)
    except ValidationError as error:
        raise WireError("schema", f"{topic}: {_first_fault(error)}") from error


def decode_header(topic: str, payload: bytes) -> tuple[tuple[int, int, str], dict[str, Any]]:
    """Return seq, t_ns and src of a message, and all its fields as they came.

    For those who keep messages and need not understand them: only the header is checked, without a model, which would
    take three times as long. The form of `src` is left to the caller, who meets the same few again and again.
    Raises WireError as `decode` does.
    """
    _, fields = _read(topic, payload)
    seq, t_ns, src, version = fields.get("seq"), fields.get("t_ns"), fields.get("src"), fields.get("v")
    if not (type(seq) is int and type(t_ns) is int and type(src) is str and type(version) is int):
        raise WireError("schema", f"{topic}: the header needs seq, t_ns and v as integers and src as text")
    if not (0 <= seq < _COUNT_LIMIT and 0 <= t_ns < _COUNT_LIMIT and version >= 1):
        raise WireError("schema", f"{topic}: seq {seq}, t_ns {t_ns} or v {version} is out of range")
    return (seq, t_ns, src), fields


def _read(topic: str, payload: bytes) -> tuple[Topic, dict[str, Any]]:
    row = TOPICS.get(topic)
    if row is None:
        raise WireError("topic", f"unknown topic {topic[:80]!r}, known topics are {', '.join(TOPICS)}")
    if len(payload) > MAX_MESSAGE_BYTES:
        raise WireError("oversized", _size_text(topic, len(payload)))
    fields = _unpack(topic, payload)
    _reject_newer(topic, fields, row.model.version)
    return row, fields


def _fields_of(part: object) -> dict[str, Any]:
    """Return the fields of a record inside a message, for msgpack."""
    if hasattr(part, "model_fields_set"):
        return part.__dict__
    # msgpack calls this for integers that are too large for it as well
    raise TypeError(f"msgpack has no form for this {type(part).__name__}")


def _unpack(topic: str, payload: bytes) -> dict[str, Any]:
    # the sizes are bounded by the payload itself, so that a short frame cannot ask for a large allocation
    size = len(payload)
    try:
        fields = msgpack.unpackb(
            payload,
            use_list=False,
            strict_map_key=True,
            max_str_len=size,
            max_bin_len=size,
            max_array_len=MAX_ITEMS,
            max_map_len=MAX_KEYS,
            max_ext_len=0,
        )
    except (ValueError, msgpack.exceptions.UnpackException, RecursionError) as error:
        # msgpack's own exceptions are not all ValueErrors; StackError and FormatError carry no text
        raise WireError("malformed", f"{topic}: not msgpack: {str(error) or type(error).__name__}") from error
    if not isinstance(fields, dict):
        raise WireError("malformed", f"{topic}: a msgpack {type(fields).__name__}, must be a map")
    return fields


def _reject_newer(topic: str, fields: dict[str, Any], known: int) -> None:
    version = fields.get("v")
    if isinstance(version, int) and not isinstance(version, bool) and version > known:
        src = fields.get("src")
        sender = repr(src[:64]) if isinstance(src, str) else "an unnamed source"
        raise WireError(
            "newer_version",
            f"{topic}: schema version {version} from {sender} is newer than version {known} known here: "
            "update this node",
        )


def _first_fault(error: ValidationError) -> str:
    fault = error.errors(include_url=False, include_context=False, include_input=False)[0]
    # an unknown key is the sender's text: no more of it than a log line holds
    key = ".".join(str(part) for part in fault["loc"])[:200] or "message"
    more = error.error_count() - 1
    return f"{key}: {fault['msg']}" + (f" (and {more} more)" if more else "")


def _size_text(name: str, size: int) -> str:
    return f"{name}: {size} bytes, at most {MAX_MESSAGE_BYTES} are allowed"

"""Encoding and decoding of messages.

A message is one msgpack map with a string key a field. Any bytes decode to a message or raise one `WireError`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, Literal, get_args, get_origin

import msgpack
import msgspec
from pydantic import BaseModel, ValidationError

from telenano.wire.messages import MAX_ITEMS, MAX_KEYS, Message, SessionControl
from telenano.wire.ranges import any_range, is_out_of_range, limited
from telenano.wire.topics import TOPICS, Topic
from telenano.wire.typed import typed_form, typed_header, typed_rows

MAX_MESSAGE_BYTES = 1 << 20
# The limit is for a message without maps and arrays of data inside; the longest has 500.
MAX_PLAIN_BYTES = 4096
# A command needs room for the node that repeats it in an event.
MAX_COMMAND_BYTES = MAX_MESSAGE_BYTES // 2
# No message has more than seven; each vector is one.
MAX_ARRAYS = 64
_COUNT_LIMIT = 2**63
_unpackb = msgpack.unpackb
# This decoder goes through a payload without keeping anything of it.
_skim = msgspec.msgpack.Decoder(msgspec.Raw).decode

Reason = Literal["frames", "topic", "oversized", "malformed", "newer_version", "schema", "range", "source", "role"]


class WireError(ValueError):
    """Bytes that are not a message; `reason` is one of a few words that can be counted."""

    def __init__(self, reason: Reason, text: str) -> None:
        super().__init__(text)
        self.reason: Reason = reason


def encode(message: Message) -> bytes:
    """Return the msgpack bytes of a message.

    Raises:
        WireError: The message is larger than its topic allows (`oversized`), so that the publisher gets the error and
            not every reader; or a text is not Unicode, or an integer is beyond 64 bits (`malformed`).
    """
    fields = message.__dict__
    if message.additions:
        fields = {key: value for key, value in fields.items() if value is not None or key not in message.additions}
    try:
        payload: bytes = msgpack.packb(fields, default=_fields_of)
    except (TypeError, ValueError, OverflowError) as error:
        raise WireError("malformed", f"{type(message).__name__} cannot be sent: {error}") from error
    if len(payload) > MAX_PLAIN_BYTES and len(payload) > (most := MOST_BYTES[type(message)]):
        raise WireError("oversized", _size_text(type(message).__name__, len(payload), most))
    return payload


def accept(topic: str, payload: bytes) -> Message:
    """Return the message that `payload` holds on `topic`, if a node may act on it.

    Raises:
        WireError: The message is not valid; the error names the topic, the key at fault and what would be right. Its
            kind is `range` where a quantity is beyond its range (`telenano.wire.ranges`).
    """
    typed = _TYPED.get(topic)
    if typed is not None and (quick := typed.read(payload)) is not None:
        return quick
    form, fields = _read(topic, payload)
    try:
        message = form.model.model_validate(fields, extra=form.unknown)
    except ValidationError as error:
        raise _first_fault(topic, error) from error
    if typed is not None:
        typed.note(message)
    return message


def compose(topic: str, fields: Mapping[str, Any], report: Callable[[str], None]) -> tuple[Message, bytes]:
    """Return a message and its bytes, with what is beyond its range at the nearer end (`telenano.wire.ranges.limited`).

    Args:
        topic: The topic, which names the model.
        fields: The fields of the message by key.
        report: Called with a sentence when a value was limited.

    Raises:
        pydantic.ValidationError: The fields do not make a valid message.
        WireError: The message is larger than `encode` allows.
    """
    typed = _COMPOSED.get(topic)
    if typed is not None and (quick := typed.compose(fields)) is not None:
        return quick
    message = limited(_FORMS[topic].model, fields, report)
    if typed is not None:
        typed.note(message)
    return message, encode(message)


def decode(topic: str, payload: bytes) -> Message:
    """Return the message that `payload` holds on `topic`, with any finite quantities.

    This is for recordings and examples. Use `accept` for what acts on a message.

    Raises:
        WireError: The message is not valid, as in `accept`, but for its ranges.
    """
    try:
        return accept(topic, payload)
    except WireError as error:
        if error.reason != "range":
            raise
    form, fields = _read(topic, payload)
    try:
        return any_range(form.model, fields, form.unknown)
    except ValidationError as error:
        raise _first_fault(topic, error) from error


def decode_header(topic: str, payload: bytes) -> tuple[tuple[int, int, str], dict[str, Any]]:
    """Return seq, t_ns and src of a message, and all its fields as they came.

    For those who keep messages and need not understand them: only the header is checked, without a model, which would
    take three times as long. The form of `src` is left to the caller, who meets the same few again and again.

    Raises:
        WireError: The header is not valid, as in `decode`.
    """
    typed = _TYPED.get(topic)
    if typed is not None and (quick := typed.fields(payload)) is not None:
        return (quick["seq"], quick["t_ns"], quick["src"]), quick
    _, fields = _read(topic, payload)
    seq, t_ns, src, version = fields.get("seq"), fields.get("t_ns"), fields.get("src"), fields.get("v")
    if not (type(seq) is int and type(t_ns) is int and type(src) is str and type(version) is int):
        raise WireError("schema", f"{topic}: the header needs seq, t_ns and v as integers and src as text")
    if not (0 <= seq < _COUNT_LIMIT and 0 <= t_ns < _COUNT_LIMIT and version >= 1):
        raise WireError("schema", f"{topic}: seq {seq}, t_ns {t_ns} or v {version} is out of range")
    return (seq, t_ns, src), fields


class _Header(msgspec.Struct, gc=False):
    """What every message begins with; `v` is the version of its schema."""

    seq: Annotated[int, msgspec.Meta(ge=0, le=_COUNT_LIMIT - 1)]
    t_ns: Annotated[int, msgspec.Meta(ge=0, le=_COUNT_LIMIT - 1)]
    src: str
    v: Annotated[int, msgspec.Meta(ge=1)]


# It does not look at the version, the length and the form of `src`.
_decode_header_alone = msgspec.msgpack.Decoder(_Header).decode


def read_header(topic: str, payload: bytes) -> tuple[int, int, str]:
    """Return seq, t_ns and src of a message, of whose other fields the bytes are skipped.

    For a recorder, which keeps messages as they came: it takes a small part of the time of `decode_header`. What is no
    msgpack map, too long, of a newer version or without a valid header is refused as there. What the other fields are,
    and a key that is there twice, is left to whoever decodes the message. Raises WireError as `decode` does.
    """
    try:
        header = _decode_header_alone(payload)
        form = _FORMS[topic]
        if header.v <= form.version and len(payload) <= form.most_bytes:
            return header.seq, header.t_ns, header.src
    except (msgspec.MsgspecError, KeyError, ValueError, RecursionError):
        # the error of the other way names what is wrong
        pass
    return decode_header(topic, payload)[0]


def fields_of(topic: str, message: Message) -> Mapping[str, Any]:
    """Return the fields of a message as plain data: records as maps. A key that is absent has None, or is not there."""
    return vars(message) if _FORMS[topic].plain else message.model_dump()


@cache
def header_check(topic: str) -> Callable[[bytes], tuple[int, int, str] | None]:
    """Return what finds seq, t_ns and src of a payload without making a message of it.

    It returns None for a payload that it leaves to `decode`: what is not valid, and some of what is.
    """
    form = _FORMS.get(topic)
    return (form and typed_header(form.model, form.most_bytes)) or _leave


def _leave(payload: bytes) -> None:
    return None


@dataclass(frozen=True, slots=True)
class _Form:
    """What the bytes of a topic's messages look like.

    `version` of the model, its number of `keys`; `head`: how a map of so many begins; `plain`: no map and no array of
    data stands inside; `most_bytes`, `most_pairs`: the most that a message may have.
    """

    model: type[Message]
    version: int
    keys: int
    head: bytes
    plain: bool
    most_bytes: int
    most_pairs: int
    unknown: Literal["ignore", "forbid"]


def _form_of(row: Topic) -> _Form:
    keys = len(row.model.model_fields)
    nested = sum(_most_pairs(field.annotation) for field in row.model.model_fields.values())
    head = bytes(msgpack.Packer().pack_map_header(keys))
    most_bytes, most_pairs = MAX_MESSAGE_BYTES if nested else MAX_PLAIN_BYTES, 1 + keys + nested
    if row.model is SessionControl:
        # who commands is told of every word that is not understood, because half a command is another command
        return _Form(row.model, row.model.version, keys, head, False, MAX_COMMAND_BYTES, most_pairs, "forbid")
    return _Form(row.model, row.model.version, keys, head, not nested, most_bytes, most_pairs + MAX_KEYS, "ignore")


def _most_pairs(annotation: Any) -> int:
    """Return the most pairs that the maps in a field can hold together, each map counting as one more."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        fields = annotation.model_fields.values()
        return 1 + len(fields) + sum(_most_pairs(field.annotation) for field in fields)
    if origin is dict:
        return 1 + MAX_KEYS
    if origin is tuple and parts[-1] is Ellipsis:
        return MAX_ITEMS * _most_pairs(parts[0])
    return max(map(_most_pairs, parts), default=0) if origin is not Literal else 0


_FORMS = {name: _form_of(row) for name, row in TOPICS.items()}
_TYPED = {
    name: typed for name, form in _FORMS.items() if form.plain and (typed := typed_form(form.model, form.most_bytes))
}
_COMPOSED = _TYPED | {
    name: rows for name, form in _FORMS.items() if not form.plain and (rows := typed_rows(form.model, form.most_bytes))
}
# The most bytes that a message may have, by its model.
MOST_BYTES = {form.model: form.most_bytes for form in _FORMS.values()}


def _read(topic: str, payload: bytes) -> tuple[_Form, dict[str, Any]]:
    form = _FORMS.get(topic)
    if form is None:
        raise WireError("topic", f"unknown topic {topic[:80]!r}, known topics are {', '.join(TOPICS)}")
    if len(payload) > form.most_bytes:
        raise WireError("oversized", _size_text(topic, len(payload), form.most_bytes))
    try:
        # msgpack makes room for every array before it has seen an item: a thousand inside each other, of which none is
        # complete, would be tens of megabytes
        _skim(payload)
        if form.plain:
            fields = _unpackb(payload, use_list=False, max_ext_len=0)
        elif len(payload) <= MAX_PLAIN_BYTES:
            fields = _unpackb(payload, use_list=False, max_ext_len=0, object_pairs_hook=_unique)
        else:
            fields = _unpack_long(payload, form)
    except _TooMuchError as error:
        raise WireError("malformed", f"{topic}: {error}") from error
    except (ValueError, msgpack.exceptions.UnpackException, msgspec.DecodeError, RecursionError) as error:
        # msgpack's own exceptions are not all ValueErrors; StackError and FormatError carry no text
        raise WireError("malformed", f"{topic}: not msgpack: {str(error) or type(error).__name__}") from error
    if type(fields) is not dict:
        raise WireError("malformed", f"{topic}: a msgpack {type(fields).__name__}, must be a map")
    # If there is no map inside, the count at the beginning of the outer map shows a key that came twice.
    if form.plain and not (payload.startswith(form.head) and len(fields) == form.keys):
        _reject_twice(topic, payload, fields)
    # The version comes before the keys, because adding keys raises it.
    if fields.get("v") != form.version:
        _reject_newer(topic, fields, form.version)
    return form, fields


def _fields_of(part: object) -> dict[str, Any]:
    """Return the fields of a record inside a message, for msgpack."""
    if hasattr(part, "model_fields_set"):
        return part.__dict__
    # msgpack calls this for integers that are too large for it as well
    raise TypeError(f"msgpack has no form for this {type(part).__name__}")


class _TooMuchError(ValueError):
    """The bytes hold what no message of the topic can; the text says what."""


_TWICE = "a map has a key twice, each may be there once"


def _unique(pairs: Sequence[tuple[Any, Any]]) -> dict[Any, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise _TooMuchError(_TWICE)
    return found


class _Budget:
    """Counts maps and arrays while a long payload is unpacked, so that refusing it costs no more than taking one."""

    def __init__(self, most_pairs: int) -> None:
        self._pairs = most_pairs
        self._arrays = MAX_ARRAYS

    def map(self, pairs: Sequence[tuple[Any, Any]]) -> dict[Any, Any]:
        self._pairs -= 1 + len(pairs)
        if self._pairs < 0:
            raise _TooMuchError("more keys than any message of this topic has")
        return _unique(pairs)

    def array(self, items: Sequence[Any]) -> Sequence[Any]:
        self._arrays -= 1
        if self._arrays < 0:
            raise _TooMuchError(f"more than {MAX_ARRAYS} arrays")
        return items


def _unpack_long(payload: bytes, form: _Form) -> Any:
    budget = _Budget(form.most_pairs)
    return _unpackb(
        payload,
        use_list=False,
        max_array_len=MAX_ITEMS,
        max_map_len=MAX_KEYS,
        max_ext_len=0,
        object_pairs_hook=budget.map,
        list_hook=budget.array,
    )


def _reject_twice(topic: str, payload: bytes, fields: dict[str, Any]) -> None:
    first = payload[0]
    pairs = first & 0x0F if first < 0xDE else int.from_bytes(payload[1 : 3 if first == 0xDE else 5])
    if pairs != len(fields):
        raise WireError("malformed", f"{topic}: {_TWICE}")


def _reject_newer(topic: str, fields: dict[str, Any], known: int) -> None:
    version = fields.get("v")
    if isinstance(version, int) and not isinstance(version, bool) and version > known:
        src = fields.get("src")
        sender = repr(src[:64]) if isinstance(src, str) else "an unnamed source"
        text = f"schema version {version} from {sender} is newer than version {known} known here: update this node"
        raise WireError("newer_version", f"{topic}: {text}")


def _first_fault(topic: str, error: ValidationError) -> WireError:
    fault = error.errors(include_url=False, include_input=False)[0]
    # an unknown key is the sender's text: no more of it than a log line holds
    key = ".".join(str(part) for part in fault["loc"])[:200] or "message"
    more = error.error_count() - 1
    text = f"{key}: {fault['msg']}" + (f" (and {more} more)" if more else "")
    return WireError("range" if is_out_of_range(fault) else "schema", f"{topic}: {text}")


def _size_text(name: str, size: int, most: int) -> str:
    return f"{name}: {size} bytes, at most {most} are allowed"

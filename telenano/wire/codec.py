"""Encoding and decoding of messages.

A message is one msgpack map with a string key for each field. Any bytes either decode to a message or raise WireError.
msgspec decodes and checks in one pass in C, and checks and encodes in another. A message that it refuses is read part
by part by `telenano.wire.refusals`, which names the fault.
"""

import contextlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args, get_origin

import msgpack
import msgspec
from msgspec import Raw

from telenano.wire.messages import Message, Record, Run, SessionControl
from telenano.wire.refusals import (
    REFUSALS,
    Beyond,
    FaultError,
    Reading,
    S,
    any_finite,
    declared_elements,
    elements_beyond,
    is_source,
    read_record,
    source_fault,
)
from telenano.wire.topics import TOPICS, Topic, row_of

MAX_MESSAGE_BYTES = 1 << 20
# The limit of a message without maps, lists and arrays of data; the longest golden vector has 500 bytes.
MAX_PLAIN_BYTES = 4096
# A command may have half the limit, because a node repeats it in an event.
MAX_COMMAND_BYTES = MAX_MESSAGE_BYTES // 2
_COUNT_LIMIT = 2**63
# Sources that are known to be well formed: matching the pattern takes as long as decoding the rest of a message.
_MOST_SOURCES = 256
_sources: set[str] = set()

Reason = Literal["frames", "topic", "oversized", "malformed", "newer_version", "schema", "range", "source", "role"]


# seq, t_ns, src and run of a message; run is None if it is absent.
Header = tuple[int, int, str, int | None]


class WireError(ValueError):
    """Bytes that are not a valid message; `reason` is one of a few words, by which nodes count them."""

    def __init__(self, reason: Reason, text: str) -> None:
        super().__init__(text)
        self.reason: Reason = reason


def encode(message: Message) -> bytes:
    """Return the msgpack bytes of a message; only their size is checked.

    Raises:
        WireError: The message is larger than its topic allows (`oversized`), so that the publisher gets the error
            instead of every reader; or a text is not Unicode, or an integer exceeds 64 bits (`malformed`).
    """
    try:
        payload = _encode(message)
    except (TypeError, ValueError, OverflowError) as error:
        raise WireError("malformed", f"{type(message).__name__} cannot be sent: {error}") from error
    if len(payload) > MAX_PLAIN_BYTES and len(payload) > (most := MOST_BYTES.get(type(message), MAX_MESSAGE_BYTES)):
        raise WireError("oversized", _size_text(type(message).__name__, len(payload), most))
    return payload


def accept(topic: str, payload: bytes) -> Message:
    """Decode the payload of a topic to a message on which a node may act.

    Raises:
        WireError: The message is not valid; the error names the topic, the faulty key, its value and the valid ones.
            Its `reason` is `range` if a quantity is beyond its range (`telenano.wire.ranges`).
    """
    form = _FORMS.get(topic)
    if form is not None and len(payload) <= form.most_bytes:
        try:
            message = form.decode(payload)
        except REFUSALS:
            pass
        else:
            if (
                message.v <= form.version
                and (message.src in _sources or _takes_source(message.src))
                and (not form.elements or form.fits(message))
            ):
                return message
    return _read(topic, payload)


def compose(
    topic: str, fields: Mapping[str, Any], report: Callable[[str], None] = lambda text: None
) -> tuple[Message, bytes]:
    """Build a message and its bytes; numbers beyond their bounds are limited to the nearer bound.

    A node thus never fails because it computed an excessive value: its end would also end the guard of a device. NumPy
    numbers are sent as plain numbers.

    Args:
        topic: The topic, which names the model.
        fields: The fields of the message by key.
        report: Called with a sentence if a value was limited.

    Raises:
        WireError: The fields are not a valid message, for instance NaN, or it is larger than `encode` allows.
        KeyError: The topic is unknown.
    """
    if (form := _FORMS.get(topic) or _form(topic)) is None:
        raise KeyError(topic)
    try:
        if form.nested:
            # msgspec.convert does not check records that exist already; a round trip through bytes does.
            message = form.decode(_encode(msgspec.convert(fields, form.model, builtin_types=(bytes,))))
        else:
            message = msgspec.convert(fields, form.model)
        payload = _encode(message)
        if (
            (message.src in _sources or _takes_source(message.src))
            and (not form.elements or form.fits(message))
            and len(payload) <= form.most_bytes
            and message.v <= form.version
        ):
            return message, payload
    except REFUSALS:
        # The slow path below reads the fields part by part, and limits a value or names the fault.
        pass
    return _compose_limited(topic, form, fields, report)


def decode(topic: str, payload: bytes) -> Message:
    """Decode the payload of a topic to a message whose quantities may have any finite value.

    This is for recordings and examples; code that acts on a message uses `accept`.

    Raises:
        WireError: The message is not valid, as in `accept`, except for its ranges.
    """
    try:
        return accept(topic, payload)
    except WireError as error:
        if error.reason != "range":
            raise
    return _read(topic, payload, any_finite)


def decode_header(topic: str, payload: bytes) -> tuple[tuple[int, int, str], dict[str, Any]]:
    """Return (seq, t_ns, src) of a message, and all its fields unchecked, with sequences as lists.

    Programs that store messages without interpreting them use it: only the header is checked.

    Raises:
        WireError: The header is not valid, as in `read_header`, or another field is not valid msgpack or UTF-8.
    """
    header = read_header(topic, payload)
    try:
        return header, msgspec.msgpack.decode(payload)
    except REFUSALS as error:
        raise WireError("malformed", f"{topic}: not msgpack: {error}") from error


class _Header(msgspec.Struct, gc=False):
    """Header that every message has; `v` is the version of its schema, and `run` may be absent."""

    seq: Annotated[int, msgspec.Meta(ge=0, le=_COUNT_LIMIT - 1)]
    t_ns: Annotated[int, msgspec.Meta(ge=0, le=_COUNT_LIMIT - 1)]
    src: str
    v: Annotated[int, msgspec.Meta(ge=1)]
    run: Run | None = None


_decode_header_alone = msgspec.msgpack.Decoder(_Header).decode


def read_header(topic: str, payload: bytes) -> tuple[int, int, str]:
    """Return (seq, t_ns, src) of a message, as `read_whole_header` does."""
    return read_whole_header(topic, payload)[:3]


def read_whole_header(topic: str, payload: bytes) -> Header:
    """Return (seq, t_ns, src, run) of a message and skip its other fields; `run` is None if it is absent.

    A recorder uses it, because it stores messages unchanged. The other fields, and the form of `src`, are checked when
    the message is decoded.

    Raises:
        WireError: The payload is not a msgpack map, too long, of a newer version, or without a valid header.
    """
    try:
        header = _decode_header_alone(payload)
        form = _FORMS[topic]
        if header.v <= form.version and len(payload) <= form.most_bytes:
            return header.seq, header.t_ns, header.src, header.run
    except (KeyError, *REFUSALS):
        # The slow path below names the fault.
        pass
    _, parts = _opened(topic, payload)
    record = _read_record(topic, _Header, parts, Reading("ignore"))
    return record.seq, record.t_ns, record.src, record.run


class _Run(msgspec.Struct, gc=False):
    run: Run | None = None


_decode_run = msgspec.msgpack.Decoder(_Run).decode


def run_in(payload: bytes) -> int | None:
    """Return the `run` of a message, whatever else is in it; None if it has none that is valid."""
    try:
        return _decode_run(payload).run
    except REFUSALS:
        return None


def fields_of(message: Record) -> dict[str, Any]:
    """Return the fields of a message as plain data, with records as dicts; an absent key has None."""
    fields = msgspec.structs.asdict(message)
    for name, value in fields.items():
        if isinstance(value, Record) or (type(value) is tuple and value and isinstance(value[0], Record)):
            fields[name] = msgspec.to_builtins(value, builtin_types=(bytes,))
    return fields


def sound_header(topic: str, payload: bytes) -> Header | None:
    """Return (seq, t_ns, src, run) if the payload is valid and exactly the bytes that this codec writes; else None.

    This excludes a repeated key, of which readers would use only the last value.
    """
    try:
        message = accept(topic, payload)
    except WireError:
        return None
    return (message.seq, message.t_ns, message.src, message.run) if _encode(message) == payload else None


def keys_twice(payload: bytes) -> list[str]:
    """Return the keys that occur more than once in a map of a valid message; readers use only the last value."""
    twice: list[str] = []

    def note(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        twice.extend(key for key, count in Counter(key for key, _ in pairs).items() if count > 1)
        return dict(pairs)

    msgpack.unpackb(payload, object_pairs_hook=note)
    return twice


@dataclass(frozen=True, slots=True)
class _Form:
    """Form of the messages of a topic, for encoding and decoding.

    `version`: the newest schema version known here. `most_bytes`: the size limit of a message. `nested`: True if it
    contains records. `elements`: names and declared types of the arrays whose elements have a range. `unknown`: whether
    unknown keys are ignored or forbidden.
    """

    model: type[Message]
    version: int
    decode: Callable[[bytes], Message]
    most_bytes: int
    nested: bool
    elements: tuple[tuple[str, Any], ...]
    unknown: Literal["ignore", "forbid"]

    def fits(self, message: Message) -> bool:
        """Return whether the elements of all arrays are within their ranges."""
        return not any(elements_beyond(kind, getattr(message, name)) for name, kind in self.elements)


def _form_of(row: Topic) -> _Form:
    fields = {field.name: field.type for field in msgspec.structs.fields(row.model)}
    parts = {part for kind in fields.values() for part in _parts(kind)}
    most_bytes = MAX_MESSAGE_BYTES if parts & {dict, Ellipsis, Record} else MAX_PLAIN_BYTES
    elements = tuple((name, kind) for name, kind in fields.items() if declared_elements(kind))
    decode_whole = msgspec.msgpack.Decoder(row.model).decode
    unknown: Literal["ignore", "forbid"] = "ignore"
    if row.model is SessionControl:
        # A command without its unknown keys would be another command, so they are refused by name.
        most_bytes, unknown = MAX_COMMAND_BYTES, "forbid"
    return _Form(row.model, row.model.version, decode_whole, most_bytes, Record in parts, elements, unknown)


def _parts(kind: Any) -> Iterator[Any]:
    """Yield the parts of a declared type: `Record` for any record, `dict` for a map, `...` for an open-ended tuple."""
    if isinstance(kind, type) and issubclass(kind, Record):
        yield Record
    elif get_origin(kind) is not Literal:
        yield get_origin(kind) or kind
        for part in get_args(kind):
            yield from _parts(part)


_FORMS = {name: _form_of(row) for name, row in TOPICS.items()}
# Size limit of a message [bytes], by its model.
MOST_BYTES = {form.model: form.most_bytes for form in _FORMS.values()}


def _form(topic: str) -> _Form | None:
    """Return the form of a topic, including those that packages declare; None for an unknown one."""
    form = _FORMS.get(topic)
    if form is None and (row := row_of(topic)) is not None:
        form = _FORMS[topic] = _form_of(row)
        MOST_BYTES[row.model] = form.most_bytes
    return form


def _number_of(value: Any) -> Any:
    """Return a NumPy number or array as Python numbers; raise TypeError for any other object."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"msgpack has no form for a {type(value).__name__}")


def _as_plain(topic: str, key: str, value: Any) -> Any:
    """Return a value as plain data, NumPy as numbers and records as dicts, so that all parts can be checked."""
    try:
        return msgspec.to_builtins(value, builtin_types=(bytes,), enc_hook=_number_of)
    except REFUSALS as error:
        raise WireError("schema", f"{topic}: {key}: {error}") from error


_encode = msgspec.msgpack.Encoder(enc_hook=_number_of).encode


def _takes_source(src: str) -> bool:
    """Return whether a source is well formed; some of the valid ones are cached."""
    if not is_source(src):
        return False
    if len(_sources) < _MOST_SOURCES:
        _sources.add(src)
    return True


def _read(topic: str, payload: bytes, beyond: Callable[[Beyond], float | None] = lambda found: None) -> Message:
    """Decode a message key by key after the fast path refused it; raise WireError for the first fault."""
    form, parts = _opened(topic, payload)
    return _with_source(topic, _read_record(topic, form.model, parts, Reading(form.unknown, beyond)))


def _read_record(topic: str, model: type[S], parts: Mapping[str, Any], how: Reading) -> S:
    try:
        return read_record(model, parts, how)
    except FaultError as error:
        raise WireError("range" if error.fault.kind == "range" else "schema", f"{topic}: {error}") from error


def _opened(topic: str, payload: bytes) -> tuple[_Form, dict[str, Raw]]:
    form = _form(topic)
    if form is None:
        raise WireError("topic", f"unknown topic {topic[:80]!r}, known topics are {', '.join(TOPICS)}")
    if len(payload) > form.most_bytes:
        raise WireError("oversized", _size_text(topic, len(payload), form.most_bytes))
    try:
        parts = _decode_parts(payload)
    except msgspec.ValidationError as error:
        got = str(error).partition(", got ")[2].partition(" - at ")
        text = "a key that is not text" if got[1] else f"a msgpack {got[0].strip('`')}, must be a map"
        raise WireError("malformed", f"{topic}: {text}") from error
    except REFUSALS as error:
        raise WireError("malformed", f"{topic}: not msgpack: {str(error) or type(error).__name__}") from error
    # Check the version before the keys, because a newer version may have others.
    version, src = (_scalar(parts.get(name)) for name in ("v", "src"))
    if type(version) is int and version > form.version:
        sender = repr(src[:64]) if isinstance(src, str) else "an unnamed source"
        version_text = f"newer than version {form.version} known here: update this node"
        raise WireError("newer_version", f"{topic}: schema version {version} from {sender} is {version_text}")
    return form, parts


_decode_parts = msgspec.msgpack.Decoder(dict[str, Raw]).decode


def _scalar(part: Raw | None) -> object:
    """Return a number or text, None for anything else."""
    try:
        return None if part is None else msgspec.msgpack.decode(part, type=int | str)
    except REFUSALS:
        return None


def _with_source(topic: str, message: Message) -> Message:
    if not _takes_source(message.src):
        raise WireError("schema", f"{topic}: {source_fault(message.src).text}")
    return message


def _compose_limited(
    topic: str, form: _Form, fields: Mapping[str, Any], report: Callable[[str], None]
) -> tuple[Message, bytes]:
    limited: list[str] = []

    def nearer_end(beyond: Beyond) -> float | None:
        if beyond.in_array:
            return None
        limited.append(f"{beyond.key} = {beyond.value!r}")
        return beyond.high if beyond.value > beyond.high else beyond.low

    plain = {key: _as_plain(topic, key, value) for key, value in fields.items()}
    message: Message | None = None
    with contextlib.suppress(*REFUSALS):
        # This succeeds if NumPy numbers were the only obstacle.
        message = msgspec.convert(plain, form.model, builtin_types=(bytes,))
    if message is None or not form.fits(message):
        message = _read_record(topic, form.model, plain, Reading("forbid", nearer_end))
    payload = encode(_with_source(topic, message))
    if limited:
        report(f"{form.model.__name__}: {limited[0]} is out of range and is sent at the end of the range")
    return message, payload


def _size_text(name: str, size: int, most: int) -> str:
    return f"{name}: {size} bytes, at most {most} are allowed"

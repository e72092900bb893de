"""A message read part by part, where msgspec refuses the whole of it.

msgspec states neither the value that it refuses nor the key inside a map. Here each field, item and element is read as
the type that is declared for it, the *kind*. So the sentence about a fault has key, value and what would be right; keys
that are not known can be left out; and a number beyond its bounds can be refused, kept or limited (`Reading`). Bytes
are decoded one level at a time (`msgspec.Raw`), so that refusing a message costs no more than reading one.
"""

import math
import re
import types
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple, NoReturn, TypeVar, Union, cast, get_args, get_origin

import msgspec
from msgspec import Meta, Raw

from telenano.wire.errors import known_names
from telenano.wire.messages import SOURCE_PATTERN, Array, Message, Record
from telenano.wire.ranges import Range

S = TypeVar("S", bound=msgspec.Struct)
R = TypeVar("R", bound=Record)
REFUSALS = (ValueError, TypeError, OverflowError, RecursionError)
is_source = re.compile(SOURCE_PATTERN.removesuffix("$")).fullmatch
# A scalar of more bytes is a text, and no number.
_MOST_SHOWN_BYTES = 256
# This stands in the place of a part whose fault was reported.
_WRONG: Any = object()
# A sentence has at most this number of characters of a value, and of a key, which may be the sender's text.
_MOST_SHOWN = 80
_MOST_KEY = 100


class Fault(NamedTuple):
    """What is wrong with a part of a message: its key, and a sentence without the topic.

    `kind`: a key is missing or unknown, the type is another one, a word is not one of those declared, a number is
    beyond its bounds (`bounds` for a count, `range` for a finite quantity), or the whole of a record is wrong.
    """

    key: str
    kind: Literal["missing", "unknown", "type", "word", "bounds", "range", "record"]
    text: str


class FaultError(ValueError):
    """A message has a fault."""

    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.text)
        self.fault = fault


class Beyond(NamedTuple):
    """A number beyond its bounds, both included.

    `range` is that of a quantity, None for a count; `in_array`: the number is an element of an array of data.
    """

    key: str
    value: float
    low: float
    high: float
    range: Range | None
    in_array: bool = False

    @property
    def fault(self) -> Fault:
        kind_of = "a number" if isinstance(self.low, float) else "a whole number"
        right = str(self.range) if self.range else f"{kind_of} from {self.low} to {self.high}"
        kind: Literal["range", "bounds"] = "range" if self.range and math.isfinite(self.value) else "bounds"
        return Fault(self.key, kind, f"{self.key} is {self.value!r}, must be {right}")


def raise_fault(fault: Fault) -> NoReturn:
    """Raise a fault."""
    raise FaultError(fault)


class Reading(NamedTuple):
    """How parts are read.

    Args:
        unknown: Whether keys that are not known are left out, or are a fault.
        beyond: Returns what to take for a number beyond its bounds, None where that is a fault.
        report: Called with each fault; by default the first one is raised.
    """

    unknown: Literal["ignore", "forbid"]
    beyond: Callable[[Beyond], float | None] = lambda found: None
    report: Callable[[Fault], None] = raise_fault


def any_finite(beyond: Beyond) -> float | None:
    """Return a finite quantity as it is; None for a count, and for a negative value of what cannot be negative."""
    if beyond.range is None or not math.isfinite(beyond.value) or (beyond.range.low == 0.0 and beyond.value < 0.0):
        return None
    return float(beyond.value)


def faults_of(model: type[Record], fields: object) -> list[Fault]:
    """Return all that is wrong with the fields of a record, keys that are not known included."""
    faults: list[Fault] = []
    read_record(model, fields, Reading("forbid", report=faults.append))
    source = fields.get("src") if issubclass(model, Message) and isinstance(fields, dict) else None
    if isinstance(source, str) and not is_source(source):
        faults.append(source_fault(source))
    return faults


def made(model: type[R], fields: Mapping[str, Any]) -> R:
    """Return a record of some fields; FaultError states the first of them that is wrong."""
    try:
        return msgspec.convert(fields, model, builtin_types=(bytes,))
    except ValueError as error:
        faults = faults_of(model, fields) or [Fault("", "record", str(error))]
        raise FaultError(faults[0]) from error


def source_fault(source: str) -> Fault:
    """Return the fault of a source that is not well formed."""
    text = f"src is {source[:_MOST_SHOWN]!r}, must be node@site, of small letters, digits and _"
    return Fault("src", "word", text)


def read_record(model: type[S], value: Any, how: Reading, key: str = "") -> S | None:
    """Return a map, of plain values or of their `Raw` bytes, as a record.

    Returns:
        The record; None after a fault that was reported.

    Raises:
        FaultError: The first fault, if `how` raises it.
    """
    parts = _opened(dict[str, Raw], value, how, key)
    if parts is None:
        return None
    fields = _fields_of(model)
    values = {}
    is_whole = True
    for name, field in fields.items():
        here = _joined(key, name)
        if name in parts:
            values[name] = _read(field.type, parts[name], how, here)
            is_whole &= values[name] is not _WRONG
            if beyond := elements_beyond(field.type, values[name]):
                element, allowed = beyond
                in_array = Beyond(f"{here}.data", element, allowed.low, allowed.high, allowed, in_array=True)
                is_whole &= _decide(in_array, how) is not _WRONG
        elif field.required:
            how.report(Fault(here, "missing", f"{here} is missing"))
            is_whole = False
    for name in [name for name in parts if name not in fields and how.unknown == "forbid"]:
        text = f"{_joined(key, name)} is not known, {known_names(name[:_MOST_KEY], fields)}"
        how.report(Fault(_joined(key, name), "unknown", text))
        is_whole = False
    try:
        return model(**values) if is_whole else None
    except ValueError as error:
        how.report(Fault(key, "record", f"{key or model.__name__}: {error}"))
        return None


@cache
def _fields_of(model: type[msgspec.Struct]) -> dict[str, msgspec.structs.FieldInfo]:
    """Return what is declared of each field of a record, which takes msgspec longer than to read one."""
    return {field.name: field for field in msgspec.structs.fields(model)}


def declared_elements(kind: Any) -> Range | None:
    """Return the range that a kind declares for the elements of an array."""
    return next((rule.extra["elements"] for rule in _rules(kind) if rule.extra and "elements" in rule.extra), None)


def elements_beyond(kind: Any, array: object) -> tuple[float, Range] | None:
    """Return an element of an array that is beyond the range declared with its kind, and that range; else None."""
    declared = declared_elements(kind) if isinstance(array, Array) and array.data else None
    if declared is None:
        return None
    elements = cast(Array, array).to_numpy()
    for value in (float(elements.min()), float(elements.max())):
        if not declared.low <= value <= declared.high:
            return value, declared
    return None


def _read(kind: Any, value: Any, how: Reading, key: str) -> Any:
    """Return a value as the kind that is declared for it, `_WRONG` after a fault that was reported."""
    try:
        return _as_kind(kind, value)
    except REFUSALS as error:
        refusal = error
    base, rules = _unwrapped(kind)
    arguments = get_args(base)
    if _is_optional(base):
        return _read(arguments[0], value, how, key)
    if isinstance(base, type) and issubclass(base, Record):
        return read_record(base, value, how, key) or _WRONG
    if get_origin(base) is dict:
        parts = _opened(_with_length(dict[str, Raw], rules), value, how, key)
        if parts is None:
            return _WRONG
        items = {name: _read(arguments[1], part, how, _joined(key, name)) for name, part in parts.items()}
        return _WRONG if _WRONG in items.values() else items
    if get_origin(base) is tuple:
        is_open = arguments[-1] is Ellipsis
        length = () if is_open else (Meta(min_length=len(arguments), max_length=len(arguments)),)
        parts = _opened(_with_length(list[Raw], (*rules, *length)), value, how, key)
        if parts is None:
            return _WRONG
        kinds = arguments[:1] * len(parts) if is_open else arguments
        pairs = enumerate(zip(kinds, parts, strict=True))
        listed = tuple(_read(one, part, how, _joined(key, at)) for at, (one, part) in pairs)
        return _WRONG if _WRONG in listed else listed
    return _read_scalar(base, rules, value, how, key, refusal)


def _read_scalar(base: Any, rules: Sequence[Meta], value: Any, how: Reading, key: str, refusal: BaseException) -> Any:
    if type(value) is Raw:
        value = _shown(value)
    is_number = type(value) is int or (type(value) is float and not math.isnan(value))
    bounds = next((rule for rule in rules if rule.ge is not None and rule.le is not None), None)
    if bounds is not None and is_number and (base is float or (base is int and type(value) is int)):
        ranges = [rule.extra["range"] for rule in rules if rule.extra and "range" in rule.extra]
        low, high = cast(float, bounds.ge), cast(float, bounds.le)
        return _decide(Beyond(key, value, low, high, ranges[0] if ranges else None), how)
    type_text, _, got = str(refusal).partition(" - at ")[0].replace("`", "").partition(", got ")
    right, fault = type_text.removeprefix("Expected "), "type"
    if get_origin(base) is Literal:
        right, fault = f"one of {', '.join(map(repr, get_args(base)))}", "word" if type(value) is str else "type"
    elif isinstance(refusal, UnicodeDecodeError):
        right = "text in UTF-8"
    elif type(value) is float and not math.isfinite(value):
        right, fault = "a finite number", "bounds"
    elif not got:
        # The type is right, and the value is not.
        fault = "word" if type(value) is str else "bounds"
    how.report(Fault(key, cast(Any, fault), f"{key} is {repr(value)[:_MOST_SHOWN]}, must be {right}"))
    return _WRONG


def _decide(beyond: Beyond, how: Reading) -> Any:
    taken = how.beyond(beyond)
    if taken is None:
        how.report(beyond.fault)
        return _WRONG
    return taken


def _as_kind(kind: Any, value: Any) -> Any:
    return (
        msgspec.msgpack.decode(value, type=kind)
        if type(value) is Raw
        else msgspec.convert(value, kind, builtin_types=(bytes,))
    )


def _opened(kind: Any, value: Any, how: Reading, key: str) -> Any:
    """Return the parts of a value, each as bytes where the value is bytes; None after a fault that was reported."""
    if type(value) is not Raw:
        # Values of Python are opened as they are, whatever their parts are.
        kind = _of_anything(kind)
    try:
        return _as_kind(kind, value)
    except REFUSALS as error:
        text = str(error).partition(" - at ")[0].replace("`", "") or type(error).__name__
        how.report(Fault(key, "type", f"{key or 'the message'}: {text[:1].lower()}{text[1:]}"))
        return None


def _of_anything(kind: Any) -> Any:
    base, rules = _unwrapped(kind)
    return _with_length(dict[str, Any] if get_origin(base) is dict else list[Any], rules)


def _shown(raw: Raw) -> Any:
    """Return a scalar, and the size of what is none."""
    size = len(memoryview(raw))
    try:
        return msgspec.msgpack.decode(raw) if size <= _MOST_SHOWN_BYTES else f"<{size} bytes>"
    except REFUSALS:
        return f"<{size} bytes>"


def _with_length(kind: Any, rules: Sequence[Meta]) -> Any:
    lengths = [rule for rule in rules if rule.max_length is not None]
    return Annotated[kind, lengths[0]] if lengths else kind


def _unwrapped(kind: Any) -> tuple[Any, tuple[Meta, ...]]:
    return (kind.__origin__, _rules(kind)) if get_origin(kind) is Annotated else (kind, ())


def _rules(kind: Any) -> tuple[Meta, ...]:
    """Return the rules of a kind, and those of what it is where it is not nil."""
    if get_origin(kind) is Annotated:
        return (*_rules(kind.__origin__), *kind.__metadata__)
    return _rules(get_args(kind)[0]) if _is_optional(kind) else ()


def _is_optional(kind: Any) -> bool:
    return get_origin(kind) in (Union, types.UnionType) and get_args(kind)[1:] == (type(None),)


def _joined(key: str, part: object) -> str:
    return f"{key}.{part}"[:_MOST_KEY] if key else str(part)[:_MOST_KEY]

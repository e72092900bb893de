"""Reading of a message part by part, after msgspec refused it as a whole.

The errors of msgspec name neither the refused value nor the key inside a map. This module therefore converts the parts
again, level by level: each field, item and element to its declared type, called its *kind*. msgspec alone still decides
about validity, but the error has key, value and bounds, unknown keys can be ignored, and a number beyond its bounds can
be refused, kept or limited (`Reading`). Bytes are decoded one level at a time (`msgspec.Raw`), so that refusing a
message costs no more than reading one.
"""

import math
import re
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, cast, get_args, get_origin

import msgspec
from msgspec import Meta, Raw

from telenano.wire.errors import known_names
from telenano.wire.messages import SOURCE_PATTERN, Array, Message, Record
from telenano.wire.ranges import Range

S = TypeVar("S", bound=msgspec.Struct)
R = TypeVar("R", bound=Record)
# An AttributeError comes from msgspec looking for the keys of an object that is no map, such as a NumPy number.
REFUSALS = (ValueError, TypeError, AttributeError, OverflowError, RecursionError)
is_source = re.compile(SOURCE_PATTERN.removesuffix("$")).fullmatch
# Scalars of more bytes are not decoded for an error text: they are texts, not numbers.
_MOST_SHOWN_BYTES = 256
# Most characters of a value, and of a key, in an error: both may be texts of the sender.
_MOST_SHOWN = 80
_MOST_KEY = 100


class Fault(NamedTuple):
    """Fault in a part of a message: the key, its kind, and a sentence without the topic.

    `kind`: a key is `missing` or `unknown`, a value has another `type`, a text is not a valid `word`, a number is
    beyond its `bounds` (a count) or `range` (a finite quantity), or a `record` as a whole is invalid.
    """

    key: str
    kind: Literal["missing", "unknown", "type", "word", "bounds", "range", "record"]
    text: str


class FaultError(ValueError):
    """A message has one fault or several."""

    def __init__(self, fault: Fault, *others: Fault) -> None:
        super().__init__(fault.text)
        self.fault = fault
        self.faults = (fault, *others)


class Beyond(NamedTuple):
    """A number beyond its inclusive bounds.

    `range` is the range of a quantity, None for a count; `in_array`: True if the number is an element of an array.
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


class Reading(NamedTuple):
    """Rules for reading the parts of a message.

    Args:
        unknown: Whether unknown keys are ignored or are a fault.
        beyond: Function that returns the replacement of a number beyond its bounds, or None to make it a fault.
        every: Whether to collect all faults, or to stop at the first one.
    """

    unknown: Literal["ignore", "forbid"]
    beyond: Callable[[Beyond], float | None] = lambda found: None
    every: bool = False


def any_finite(beyond: Beyond) -> float | None:
    """Return a finite quantity unchanged; None for a count, and for a negative value if the range begins at 0."""
    if beyond.range is None or not math.isfinite(beyond.value) or (beyond.range.low == 0.0 and beyond.value < 0.0):
        return None
    return float(beyond.value)


def faults_of(model: type[Record], fields: object) -> list[Fault]:
    """Return all faults in the fields of a record, including unknown keys; empty if there are none."""
    faults: list[Fault] = []
    try:
        read_record(model, fields, Reading("forbid", every=True))
    except FaultError as error:
        faults.extend(error.faults)
    source = fields.get("src") if issubclass(model, Message) and isinstance(fields, dict) else None
    if isinstance(source, str) and not is_source(source):
        faults.append(source_fault(source))
    return faults


def made(model: type[R], fields: Mapping[str, Any]) -> R:
    """Return a record built from fields; raise FaultError for the first fault."""
    try:
        return msgspec.convert(fields, model, builtin_types=(bytes,))
    except ValueError as error:
        faults = faults_of(model, fields) or [Fault("", "record", str(error))]
        raise FaultError(faults[0]) from error


def source_fault(source: str) -> Fault:
    """Return the fault of a malformed source."""
    text = f"src is {source[:_MOST_SHOWN]!r}, must be node@site, of small letters, digits and _"
    return Fault("src", "word", text)


def read_record(model: type[S], value: Any, how: Reading, key: str = "") -> S:
    """Convert a map of plain values, or of their `Raw` bytes, to a record.

    Raises:
        FaultError: The map has a fault; unknown keys come last.
    """
    parts = _opened(dict, (), value, key)
    fields = _fields_of(model)
    names = [name for name, field in fields.items() if name in parts or field.required]
    if how.unknown == "forbid":
        names += [name for name in parts if name not in fields]

    def read_field(name: str) -> Any:
        here = _joined(key, name)
        if name not in fields:
            raise _error(here, "unknown", f"{here} is not known, {known_names(name[:_MOST_KEY], fields)}")
        if name not in parts:
            raise _error(here, "missing", f"{here} is missing")
        value = _read(fields[name].type, parts[name], how, here)
        if beyond := elements_beyond(fields[name].type, value):
            element, allowed = beyond
            _decide(Beyond(f"{here}.data", element, allowed.low, allowed.high, allowed, in_array=True), how)
        return value

    values = _each(read_field, names, how)
    try:
        return model(**values)
    except ValueError as error:
        raise _error(key, "record", f"{key or model.__name__}: {error}") from error


def _read(kind: Any, value: Any, how: Reading, key: str) -> Any:
    """Convert a value to its declared kind."""
    try:
        return _as_kind(kind, value)
    except REFUSALS as error:
        refusal = error
    base, rules = _unwrapped(kind)
    arguments = get_args(base)
    if isinstance(base, type) and issubclass(base, Record):
        return read_record(base, value, how, key)
    if (container := get_origin(base)) is dict:
        parts = _opened(dict, rules, value, key)
        return _each(lambda name: _read(arguments[1], parts[name], how, _joined(key, name)), parts, how)
    if container is tuple:
        is_open = arguments[-1] is Ellipsis
        length = Meta(min_length=len(arguments), max_length=len(arguments))
        parts = _opened(list, rules if is_open else (length,), value, key)
        kinds = arguments[:1] * len(parts) if is_open else arguments
        items = _each(lambda at: _read(kinds[at], parts[at], how, _joined(key, at)), range(len(parts)), how)
        return tuple(items.values())
    return _read_scalar(base, rules, value, how, key, refusal)


def _each(read: Callable[[Any], Any], names: Iterable[Any], how: Reading) -> dict[Any, Any]:
    """Read the parts of a map, list or record and return them by name; raise FaultError for one or all faults."""
    values: dict[Any, Any] = {}
    faults: list[Fault] = []
    for name in names:
        try:
            values[name] = read(name)
        except FaultError as error:
            if not how.every:
                raise
            faults += error.faults
    if faults:
        raise FaultError(*faults)
    return values


def _read_scalar(base: Any, rules: Sequence[Meta], value: Any, how: Reading, key: str, refusal: BaseException) -> Any:
    if type(value) is Raw:
        value = _shown(value)
    is_number = type(value) is int or (type(value) is float and not math.isnan(value))
    bounds = next((rule for rule in rules if rule.ge is not None and rule.le is not None), None)
    if bounds is not None and is_number and (base is float or (base is int and type(value) is int)):
        ranges = [rule.extra["range"] for rule in rules if rule.extra and "range" in rule.extra]
        low, high = cast(float, bounds.ge), cast(float, bounds.le)
        return _decide(Beyond(key, value, low, high, ranges[0] if ranges else None), how)
    type_text, _, got = _told(refusal).partition(", got ")
    right, kind = type_text.removeprefix("Expected "), "type"
    if get_origin(base) is Literal:
        right, kind = f"one of {', '.join(map(repr, get_args(base)))}", "word" if type(value) is str else "type"
    elif isinstance(refusal, UnicodeDecodeError):
        right = "text in UTF-8"
    elif type(value) is float and not math.isfinite(value):
        right, kind = "a finite number", "bounds"
    elif not got:
        # The type is right, but the value is not.
        kind = "word" if type(value) is str else "bounds"
    raise _error(key, kind, f"{key} is {repr(value)[:_MOST_SHOWN]}, must be {right}")


def _decide(beyond: Beyond, how: Reading) -> float:
    number = how.beyond(beyond)
    if number is None:
        raise FaultError(beyond.fault)
    return number


def _error(key: str, kind: str, text: str) -> FaultError:
    return FaultError(Fault(key, cast(Any, kind), text))


def _as_kind(kind: Any, value: Any) -> Any:
    return (
        msgspec.msgpack.decode(value, type=kind)
        if type(value) is Raw
        else msgspec.convert(value, kind, builtin_types=(bytes,))
    )


def _opened(container: type, rules: Sequence[Meta], value: Any, key: str) -> Any:
    """Return the unconverted parts of a map or list."""
    part: Any = Raw if type(value) is Raw else Any
    kind: Any = dict[str, part] if container is dict else list[part]
    for rule in rules:
        if rule.max_length is not None:
            kind = Annotated[kind, rule]
    try:
        return _as_kind(kind, value)
    except REFUSALS as error:
        wrong_type = f"expected {'object' if container is dict else 'array'}, got {type(value).__name__}"
        text = wrong_type if isinstance(error, AttributeError) else _told(error) or type(error).__name__
        raise _error(key, "type", f"{key or 'the message'}: {text[:1].lower()}{text[1:]}") from error


def _told(refusal: BaseException) -> str:
    """Return the text of a msgspec error without its path, which lacks the keys of maps, and without nil."""
    return str(refusal).partition(" - at ")[0].replace("`", "").replace(" | null", "")


def _shown(raw: Raw) -> Any:
    """Return the value of a short scalar for an error text, else a text with its size."""
    size = len(memoryview(raw))
    try:
        return msgspec.msgpack.decode(raw) if size <= _MOST_SHOWN_BYTES else f"<{size} bytes>"
    except REFUSALS:
        return f"<{size} bytes>"


@cache
def _fields_of(model: type[msgspec.Struct]) -> dict[str, msgspec.structs.FieldInfo]:
    """Return the declared fields of a record; cached because msgspec takes longer for this than for decoding one."""
    return {field.name: field for field in msgspec.structs.fields(model)}


def declared_elements(kind: Any) -> Range | None:
    """Return the range that a kind declares for the elements of an array; None if it declares none."""
    return next(
        (rule.extra["elements"] for rule in _unwrapped(kind)[1] if rule.extra and "elements" in rule.extra), None
    )


def elements_beyond(kind: Any, array: object) -> tuple[float, Range] | None:
    """Return an element beyond the range that the array's kind declares, and that range; None if all are within."""
    declared = declared_elements(kind) if isinstance(array, Array) and array.data else None
    if declared is None:
        return None
    elements = cast(Array, array).to_numpy()
    for value in (float(elements.min()), float(elements.max())):
        if not declared.low <= value <= declared.high:
            return value, declared
    return None


def _unwrapped(kind: Any) -> tuple[Any, tuple[Meta, ...]]:
    """Return the type of a kind without None, and all its rules."""
    if get_origin(kind) is Annotated:
        base, rules = _unwrapped(kind.__origin__)
        return base, (*rules, *kind.__metadata__)
    is_optional = get_origin(kind) in (Union, types.UnionType) and get_args(kind)[1:] == (type(None),)
    return _unwrapped(get_args(kind)[0]) if is_optional else (kind, ())


def _joined(key: str, part: object) -> str:
    return f"{key}.{part}"[:_MOST_KEY] if key else str(part)[:_MOST_KEY]

"""Messages in the form that other tools read: JSON values, and flat rows of named columns."""

import base64
import contextlib
import json
from collections.abc import Iterable, Mapping, Sequence, Set
from itertools import chain
from operator import itemgetter
from typing import Any

import msgspec
import numpy as np

from telenano.recording.messages import RecordedMessage
from telenano.wire.errors import RecordingError
from telenano.wire.messages import Array, Record

_SCALARS = (bool, int, float, str)
_SCALAR_TYPES = frozenset(_SCALARS)
_SCALAR_OR_NONE = _SCALAR_TYPES | {type(None)}
# values, and their types
TypedColumn = tuple[Sequence[Any], set[type]]
# a message that lacks the field
_ABSENT = object()


def plain(message: RecordedMessage) -> dict[str, Any]:
    """Return a message as JSON values: arrays as lists of numbers, bytes as base64.

    The fields of a message that this version cannot decode are returned as they are.

    Raises:
        RecordingError: The payload is not a msgpack map either.
    """
    try:
        return json_fields(message.decode())
    except RecordingError:
        return {key: json_value(value) for key, value in message.fields().items()}


def json_fields(record: Record) -> dict[str, Any]:
    """Return the fields of a record as JSON values: arrays as lists of numbers, bytes as base64."""
    # Most fields of most messages are scalars, for which a call takes most of the time.
    return {
        key: value if type(value) in _SCALAR_OR_NONE else json_value(value)
        for key, value in msgspec.structs.asdict(record).items()
    }


def line(message: RecordedMessage) -> dict[str, Any]:
    """Return a message with the times and names of its record, for JSON lines."""
    return {
        "channel": message.channel_topic,
        "src": message.src,
        "log_ns": message.log_ns,
        "publish_ns": message.publish_ns,
        "seq": message.seq,
        "message": plain(message),
    }


def row(message: RecordedMessage) -> dict[str, Any]:
    """Return a message as a flat row: `position_m.0` for parts, arrays as lists, maps and lists of maps as JSON."""
    return {"log_ns": message.log_ns, "publish_ns": message.publish_ns} | flat(_fields(message))


def flat(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a message as a flat row, as `row` does."""
    values: dict[str, Any] = {}
    for key, value in fields.items():
        _flatten(key, value, values)
    return values


def table(messages: Iterable[RecordedMessage]) -> dict[str, list[Any]]:
    """Return columns of equal length with values of one type each; None where a message has no such value."""
    return {name: uniform(values) for name, values in columns_of(list(messages)).items()}


def columns_of(messages: Sequence[RecordedMessage]) -> dict[str, Sequence[Any]]:
    """Return the rows of messages as columns of equal length, with values as they came; None where there is none."""
    return {name: values for name, (values, _) in typed_columns(messages).items()}


def typed_columns(messages: Sequence[RecordedMessage]) -> dict[str, TypedColumn]:
    """Return what `columns_of` does, each column with the types of its values."""
    if not messages:
        return {}
    typed: dict[str, TypedColumn] = {
        "log_ns": _typed([message.log_ns for message in messages]),
        "publish_ns": _typed([message.publish_ns for message in messages]),
    }
    for name, values in _fields_in_columns([_fields(message) for message in messages]):
        typed |= _columns_of_field(name, values)
    return typed


def _typed(values: Sequence[Any]) -> TypedColumn:
    return values, set(map(type, values))


def _columns_of_field(name: str, values: Sequence[Any]) -> dict[str, TypedColumn]:
    """Return a field as its columns: itself, those of a vector of one length, or of parts of several kinds."""
    whole = _typed(values)
    if whole[1] <= _SCALAR_OR_NONE:
        return {name: whole}
    if whole[1] == {tuple} and len(set(map(len, values))) == 1:
        parts = {f"{name}.{number}": _typed(part) for number, part in enumerate(zip(*values, strict=True))}
        if parts and all(kinds <= _SCALAR_TYPES for _, kinds in parts.values()):
            return parts
    return {column: _typed(part) for column, part in _flat_columns(name, values).items()}


def _fields(message: RecordedMessage) -> Mapping[str, Any]:
    try:
        return msgspec.structs.asdict(message.decode())
    except RecordingError:
        return message.fields()


def _fields_in_columns(rows: Sequence[Mapping[str, Any]]) -> Iterable[tuple[str, Sequence[Any]]]:
    """Return the values of each field, in the order of the rows."""
    names = tuple(rows[0])
    if len(names) > 1 and all(map(len(names).__eq__, map(len, rows))):
        with contextlib.suppress(KeyError):
            return list(zip(names, zip(*map(itemgetter(*names), rows), strict=True), strict=True))
    every = dict.fromkeys(chain.from_iterable(rows))
    return [(name, [row.get(name, _ABSENT) for row in rows]) for name in every]


def _flat_columns(name: str, values: Sequence[Any]) -> dict[str, list[Any]]:
    """Return the columns of a field that has parts of several kinds."""
    rows: list[dict[str, Any]] = [{} for _ in values]
    for value, row in zip(values, rows, strict=True):
        if value is not _ABSENT:
            _flatten(name, value, row)
    return {column: [row.get(column) for row in rows] for column in dict.fromkeys(chain.from_iterable(rows))}


def _flatten(name: str, value: Any, columns: dict[str, Any]) -> None:
    if isinstance(value, Array):
        columns[name] = value.to_numpy().ravel().tolist()
    elif isinstance(value, Record):
        for key, inner in msgspec.structs.asdict(value).items():
            _flatten(f"{name}.{key}", inner, columns)
    elif isinstance(value, tuple | list) and all(isinstance(item, _SCALARS) for item in value) and value:
        for number, item in enumerate(value):
            columns[f"{name}.{number}"] = item
    elif value is None or isinstance(value, _SCALARS):
        columns[name] = value
    else:
        columns[name] = json.dumps(json_value(value))


def uniform(values: Sequence[Any], kinds: Set[type] | None = None) -> list[Any]:
    """Return values of one type: whole numbers among others as floats, and anything else that is mixed as JSON.

    Args:
        values: Some values of a column, or all.
        kinds: The types of all values of the column; None where `values` are all.
    """
    kinds = (set(map(type, values)) if kinds is None else kinds) - {type(None)}
    if len(kinds) <= 1:
        return list(values)
    if kinds <= {int, float}:
        return [None if value is None else float(value) for value in values]
    return [None if value is None else json.dumps(value) for value in values]


def json_value(value: Any) -> Any:
    """Return a value of a message as JSON holds it."""
    if type(value) in _SCALAR_OR_NONE:
        return value
    if isinstance(value, Array):
        return value.to_numpy().tolist()
    if isinstance(value, Record):
        return json_fields(value)
    if isinstance(value, Mapping):
        return {str(key): json_value(inner) for key, inner in value.items()}
    if isinstance(value, tuple | list):
        return [json_value(item) for item in value]
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    return value if np.isscalar(value) else str(value)

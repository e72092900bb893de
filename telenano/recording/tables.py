"""Conversion of messages for other tools: JSON values, and flat rows of named columns."""

import contextlib
import json
from collections.abc import Iterable, Mapping, Sequence, Set
from itertools import chain
from operator import itemgetter
from typing import Any, NamedTuple

import msgspec

from telenano.recording.json_values import SCALAR_OR_NONE, SCALAR_TYPES, SCALARS, json_value
from telenano.recording.messages import RecordedMessage
from telenano.wire.errors import RecordingError
from telenano.wire.messages import Array, Record

# Stands for the field of a message that lacks it.
_ABSENT = object()


class TypedColumn(NamedTuple):
    """A column of a message table: its original values, and the set of their types."""

    values: Sequence[Any]
    kinds: set[type]

    @classmethod
    def of(cls, values: Sequence[Any]) -> "TypedColumn":
        """Return a column of values with their types."""
        return cls(values, set(map(type, values)))

    def uniform(self, kinds: Set[type] | None = None) -> list[Any]:
        """Return the values in one type: integers mixed with floats become floats, other mixtures become JSON texts.

        Args:
            kinds: The types of the whole column if this is a part of it; None if this is the whole.
        """
        kinds = (self.kinds if kinds is None else kinds) - {type(None)}
        if len(kinds) <= 1:
            return list(self.values)
        if kinds <= {int, float}:
            return [None if value is None else float(value) for value in self.values]
        return [None if value is None else json.dumps(value) for value in self.values]


def line(message: RecordedMessage) -> dict[str, Any]:
    """Return a message and the times [ns] and names of its record, for JSON lines."""
    return {
        "channel": message.channel_topic,
        "src": message.src,
        "log_ns": message.log_ns,
        "publish_ns": message.publish_ns,
        "seq": message.seq,
        "message": message.plain(),
    }


def row(message: RecordedMessage) -> dict[str, Any]:
    """Return a message as a flat row: `position_m.0` for components, arrays as lists, other nested values as JSON."""
    return {"log_ns": message.log_ns, "publish_ns": message.publish_ns} | flat(_fields(message))


def flat(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a message as a flat row, as `row` does."""
    values: dict[str, Any] = {}
    for key, value in fields.items():
        _flatten(key, value, values)
    return values


def table(messages: Iterable[RecordedMessage]) -> dict[str, list[Any]]:
    """Return columns of equal length, each in one type; None stands for a missing value."""
    return {name: column.uniform() for name, column in columns_of(list(messages)).items()}


def columns_of(messages: Sequence[RecordedMessage]) -> dict[str, TypedColumn]:
    """Return the rows of messages as columns of equal length with their original values; None for a missing one."""
    if not messages:
        return {}
    typed: dict[str, TypedColumn] = {
        "log_ns": TypedColumn.of([message.log_ns for message in messages]),
        "publish_ns": TypedColumn.of([message.publish_ns for message in messages]),
    }
    for name, values in _fields_in_columns([_fields(message) for message in messages]):
        typed |= _columns_of_field(name, values)
    return typed


def _columns_of_field(name: str, values: Sequence[Any]) -> dict[str, TypedColumn]:
    """Return the columns of a field: one for a scalar, one for each component of a vector or each flattened part."""
    whole = TypedColumn.of(values)
    if whole.kinds <= SCALAR_OR_NONE:
        return {name: whole}
    if whole.kinds == {tuple} and len(set(map(len, values))) == 1:
        parts = {f"{name}.{number}": TypedColumn.of(part) for number, part in enumerate(zip(*values, strict=True))}
        if parts and all(kinds <= SCALAR_TYPES for _, kinds in parts.values()):
            return parts
    return {column: TypedColumn.of(part) for column, part in _flat_columns(name, values).items()}


def _fields(message: RecordedMessage) -> Mapping[str, Any]:
    try:
        return msgspec.structs.asdict(message.decode())
    except RecordingError:
        return message.fields()


def _fields_in_columns(rows: Sequence[Mapping[str, Any]]) -> Iterable[tuple[str, Sequence[Any]]]:
    """Return name and values of each field, in the order of the rows; `_ABSENT` stands for a missing value."""
    names = tuple(rows[0])
    if len(names) > 1 and all(map(len(names).__eq__, map(len, rows))):
        with contextlib.suppress(KeyError):
            return list(zip(names, zip(*map(itemgetter(*names), rows), strict=True), strict=True))
    every = dict.fromkeys(chain.from_iterable(rows))
    return [(name, [row.get(name, _ABSENT) for row in rows]) for name in every]


def _flat_columns(name: str, values: Sequence[Any]) -> dict[str, list[Any]]:
    """Return the columns of a nested field, flattened row by row."""
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
    elif isinstance(value, tuple | list) and all(isinstance(item, SCALARS) for item in value) and value:
        for number, item in enumerate(value):
            columns[f"{name}.{number}"] = item
    elif value is None or isinstance(value, SCALARS):
        columns[name] = value
    else:
        columns[name] = json.dumps(json_value(value))

"""Messages in the form that other tools read: JSON values, and flat rows of named columns."""

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import BaseModel

from proto.errors import RecordingError
from proto.messages import Array
from recording.messages import RecordedMessage

_SCALARS = (bool, int, float, str)


def plain(message: RecordedMessage) -> dict[str, Any]:
    """Return a message as JSON values: arrays as lists of numbers, bytes as base64.

    The fields of a message that this version cannot decode are returned as they are.

    Raises:
        RecordingError: The payload is not a msgpack map either.
    """
    try:
        return json_fields(message.decode())
    except RecordingError:
        return {key: _plain(value) for key, value in message.fields().items()}


def json_fields(model: BaseModel) -> dict[str, Any]:
    """Return the fields of a model as JSON values: arrays as lists of numbers, bytes as base64."""
    return {key: _plain(value) for key, value in model.__dict__.items()}


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
    found: dict[str, Any] = {"log_ns": message.log_ns, "publish_ns": message.publish_ns}
    try:
        fields = message.decode().__dict__
    except RecordingError:
        fields = message.fields()
    return found | flat(fields)


def flat(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a message as a flat row, as `row` does."""
    found: dict[str, Any] = {}
    for key, value in fields.items():
        _flatten(key, value, found)
    return found


def table(messages: Iterable[RecordedMessage]) -> dict[str, list[Any]]:
    """Return columns of equal length with values of one type each; None where a message has no such value."""
    rows = [row(message) for message in messages]
    names = list(dict.fromkeys(name for found in rows for name in found))
    return {name: uniform([found.get(name) for found in rows]) for name in names}


def _flatten(name: str, value: Any, found: dict[str, Any]) -> None:
    if isinstance(value, Array):
        found[name] = value.to_numpy().ravel().tolist()
    elif isinstance(value, BaseModel):
        for key, inner in value.__dict__.items():
            _flatten(f"{name}.{key}", inner, found)
    elif isinstance(value, tuple | list) and all(isinstance(item, _SCALARS) for item in value) and value:
        for number, item in enumerate(value):
            found[f"{name}.{number}"] = item
    elif value is None or isinstance(value, _SCALARS):
        found[name] = value
    else:
        found[name] = json.dumps(_plain(value))


def uniform(values: Sequence[Any]) -> list[Any]:
    """Return values of one type: whole numbers among others as floats, and anything else that is mixed as JSON."""
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) <= 1:
        return list(values)
    if kinds <= {int, float}:
        return [None if value is None else float(value) for value in values]
    return [None if value is None else json.dumps(value) for value in values]


def _plain(value: Any) -> Any:
    if isinstance(value, Array):
        return value.to_numpy().tolist()
    if isinstance(value, BaseModel):
        return json_fields(value)
    if isinstance(value, Mapping):
        return {str(key): _plain(inner) for key, inner in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    return value if np.isscalar(value) or value is None else str(value)

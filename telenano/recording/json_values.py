"""Conversion of a message's values to JSON values."""

import base64
from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from telenano.wire.messages import Array, Record

SCALARS = (bool, int, float, str)
SCALAR_TYPES = frozenset(SCALARS)
SCALAR_OR_NONE = SCALAR_TYPES | {type(None)}


def json_fields(record: Record) -> dict[str, Any]:
    """Return the fields of a record as JSON values: arrays as lists of numbers, bytes as base64."""
    # Most fields are scalars, for which the call of `json_value` would take most of the time.
    return {
        key: value if type(value) in SCALAR_OR_NONE else json_value(value)
        for key, value in msgspec.structs.asdict(record).items()
    }


def json_value(value: Any) -> Any:
    """Return a message's value as a JSON value: arrays and tuples as lists, bytes as base64, other types as text."""
    if type(value) in SCALAR_OR_NONE:
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

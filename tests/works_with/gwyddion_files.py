"""The container of Gwyddion, read by its published layout, so that no library stands between it and a test."""

import struct
from pathlib import Path
from typing import Any

import numpy as np

_MAGIC = b"GWYP"
_SIZES = {"b": 1, "c": 1, "i": 4, "q": 8, "d": 8}
_TYPES = {"i": "<i4", "q": "<i8", "d": "<f8"}


def read_gwy(path: Path) -> dict[str, Any]:
    """Return the entries of a .gwy file; an object in it is a dictionary as well, arrays are flat."""
    content = path.read_bytes()
    assert content[: len(_MAGIC)] == _MAGIC, f"{path}: no Gwyddion file"
    return _object(content, len(_MAGIC))[0]


def _text(content: bytes, at: int) -> tuple[str, int]:
    end = content.index(b"\0", at)
    return content[at:end].decode(), end + 1


def _object(content: bytes, at: int) -> tuple[dict[str, Any], int]:
    _, at = _text(content, at)
    (size,) = struct.unpack_from("<I", content, at)
    at, end = at + 4, at + 4 + size
    found: dict[str, Any] = {}
    while at < end:
        name, at = _text(content, at)
        kind, at = chr(content[at]), at + 1
        found[name], at = _value(content, at, kind)
    return found, end


def _value(content: bytes, at: int, kind: str) -> tuple[Any, int]:
    count = 1
    if kind.isupper():
        (count,) = struct.unpack_from("<I", content, at)
        at += 4
    lower = kind.lower()
    if lower in "os":
        values = []
        for _ in range(count):
            value, at = (_object if lower == "o" else _text)(content, at)
            values.append(value)
        return (values if kind.isupper() else values[0]), at
    size = _SIZES[lower] * count
    if lower not in _TYPES:
        return content[at : at + size], at + size
    numbers = np.frombuffer(content, _TYPES[lower], count, at)
    return (numbers if kind.isupper() else numbers[0]), at + size

"""Maps in Gwyddion's own files (.gwy): nothing in one is believed before it is compared with the length of the file.

A file is one object: a name, a size, and components, each with a name, a letter for its type and a value. Format:
<http://gwyddion.net/documentation/user-guide-en/gwyfile-format.html>. Only the container and its data fields are read;
other objects are passed over by their size.
"""

import mmap
import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from presets.regular_files import open_regular

Bytes = bytes | mmap.mmap

_MAGIC = b"GWYP"
_SIZE = struct.Struct("<I")
_ATOMS = {"b": "<?", "c": "<c", "i": "<i", "q": "<q", "d": "<d"}
_ITEM_BYTES = {"C": 1, "I": 4, "Q": 8, "D": 8}


class DataField(NamedTuple):
    """A map: title, values with rows from the top down, width and depth, and the units of both as the file has them."""

    title: str
    values: npt.NDArray[np.float64]
    width: float
    depth: float
    unit_xy: str
    unit_z: str


class _Part(NamedTuple):
    """A component, or an object: its name, the letter of its type, and where its value or its components are."""

    name: str
    kind: str
    start: int
    end: int


def read_gwy(path: Path, most_pixels: int) -> list[DataField]:
    """Return the maps in a file, in the order of their keys.

    Args:
        path: The file.
        most_pixels: The most pixels that a side may have.

    Raises:
        OSError: The file cannot be read.
        ValueError: The content cannot be used; the message says what is wrong.
    """
    with open_regular(path) as file:
        head = file.read(len(_MAGIC))
        if head != _MAGIC:
            raise ValueError("is no Gwyddion file: it does not begin with GWYP")
        data = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    whole = object_at(data, len(_MAGIC), len(data))
    if whole.name != "GwyContainer" or whole.end != len(data):
        raise ValueError("is no whole Gwyddion file: it must be one container of the length that it states")
    parts = {part.name: part for part in components(data, whole)}
    fields = []
    for key in sorted(key for key in parts if re.fullmatch(r"/\d+/data", key)):
        part, title = parts[key], parts.get(f"{key}/title")
        name = str(value_of(data, title)) if title is not None and title.kind == "s" else key
        field = object_at(data, part.start, part.end) if part.kind == "o" else None
        if field is not None and field.name == "GwyDataField":
            fields.append(_field(data, field, name, most_pixels))
    return fields


def _field(data: Bytes, field: _Part, title: str, most_pixels: int) -> DataField:
    parts = {part.name: part for part in components(data, field)}

    def value(name: str, kind: str) -> Any:
        part = parts.get(name)
        if part is None or part.kind != kind:
            raise ValueError(f"the map {title} has no {name}, which must be of type {kind}")
        return value_of(data, part)

    columns, rows = (value(name, "i") for name in ("xres", "yres"))
    if not (2 <= columns <= most_pixels and 2 <= rows <= most_pixels):
        raise ValueError(f"the map {title} is of {columns} x {rows} pixels; a side has 2 to {most_pixels}")
    heights = value("data", "D")
    if len(heights) != columns * rows:
        raise ValueError(f"the map {title} has {len(heights)} heights for {columns} x {rows} pixels")
    units = [_unit(data, parts.get(name)) for name in ("si_unit_xy", "si_unit_z")]
    return DataField(title, heights.reshape(rows, columns), value("xreal", "d"), value("yreal", "d"), *units)


def _unit(data: Bytes, part: _Part | None) -> str:
    if part is None or part.kind != "o":
        return ""
    texts = [each for each in components(data, object_at(data, part.start, part.end)) if each.name == "unitstr"]
    return str(value_of(data, texts[0])) if texts and texts[0].kind == "s" else ""


def value_of(data: Bytes, part: _Part) -> Any:
    """Return the value of a component: a number, a text, or an array of numbers that is not copied.

    Raises:
        KeyError: The component is of another type.
    """
    if part.kind == "s":
        return data[part.start : part.end - 1].decode("utf-8", "replace")
    if part.kind == "D":
        count = (part.end - part.start) // 8
        return np.frombuffer(data, "<f8", count, part.start)
    return struct.unpack_from(_ATOMS[part.kind], data, part.start)[0]


def items_of(data: Bytes) -> dict[str, Any]:
    """Return the components of a single object by their names; ValueError, KeyError or struct.error if it is none."""
    return {part.name: value_of(data, part) for part in components(data, object_at(data, 0, len(data)))}


def components(data: Bytes, whole: _Part) -> Iterator[_Part]:
    """Yield the components of an object; ValueError where one goes beyond it."""
    position = whole.start
    while position < whole.end:
        name, position = _text(data, position, whole.end)
        kind = chr(data[_within(position, 1, whole.end) - 1])
        part = _Part(name, kind, *_extent(data, kind, position + 1, whole.end))
        yield part
        position = part.end


def _extent(data: Bytes, kind: str, start: int, limit: int) -> tuple[int, int]:
    """Return where the value of a component begins and ends; of an array of numbers, its items."""
    if kind in _ATOMS:
        return start, _within(start, struct.calcsize(_ATOMS[kind]), limit)
    if kind == "s":
        return start, _text(data, start, limit)[1]
    if kind == "o":
        return start, object_at(data, start, limit).end
    if kind not in "CIQDSO":
        raise ValueError(f"is no whole Gwyddion file: a value at byte {start} is of the unknown type {kind!r}")
    items = _within(start, _SIZE.size, limit)
    (count,) = _SIZE.unpack_from(data, start)
    if kind in _ITEM_BYTES:
        return items, _within(items, count * _ITEM_BYTES[kind], limit)
    end = items
    for _ in range(count):
        end = _text(data, end, limit)[1] if kind == "S" else object_at(data, end, limit).end
    return items, end


def object_at(data: Bytes, start: int, limit: int) -> _Part:
    """Return the object that begins at a byte; ValueError where it goes beyond the limit."""
    name, position = _text(data, start, limit)
    begin = _within(position, _SIZE.size, limit)
    return _Part(name, "o", begin, _within(begin, _SIZE.unpack_from(data, position)[0], limit))


def _text(data: Bytes, start: int, limit: int) -> tuple[str, int]:
    """Return a text and the position after the zero byte at its end."""
    end = data.find(b"\0", start, limit)
    if end < 0:
        raise ValueError(f"is no whole Gwyddion file: the text at byte {start} has no end")
    return data[start:end].decode("utf-8", "replace"), end + 1


def _within(start: int, size: int, limit: int) -> int:
    """Return where something of that size ends; ValueError where that is beyond what it is part of."""
    if size > limit - start:
        raise ValueError(f"is no whole Gwyddion file: {size} bytes at byte {start} would go beyond byte {limit}")
    return start + size

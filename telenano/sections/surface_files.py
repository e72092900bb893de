"""Read height maps from files: .gsf, .npy and text here, formats of other instruments by the readers of packages.

In these three the first row is the top of the picture, as Gwyddion exports them; in a surface y rises with the row. The
size that a header states is compared with the length of the file before memory is allocated. Readers of packages run in
a child process with limits.
"""

import math
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from telenano.afm.sample.surface import MOST_PIXELS, SHAPES, Surface, checked
from telenano.files.regular_files import open_regular
from telenano.files.text_tables import TextTable, as_number
from telenano.files.units import unit_of
from telenano.settings.file_readers import read_by_package
from telenano.wire.errors import ConfigError, described, probably_meant

GSF_MAGIC = b"Gwyddion Simple Field 1.0\n"
_LONGEST_GSF_HEADER = 1 << 16
_NPY_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
# Metres in a unit of length, as files write it.
METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9, "pm": 1e-12, "Å": 1e-10}
_LENGTH = (("m", 1.0),)
_TEXTS = (".txt", ".csv", ".tsv", ".asc")
# Patterns for the head of a text matrix: a side with its unit, and the unit of the values.
_HEAD_PATTERNS = {
    "width": r"(?i)\bwidth\s*[:=]\s*([\d.,eE+-]+)\s*(\S+)",
    "height": r"(?i)\bheight\s*[:=]\s*([\d.,eE+-]+)\s*(\S+)",
    "values": r"(?i)\b(?:value|z)[ -]*units?\s*[:=]\s*(\S+)",
}
# A table of two columns with more rows than this is a curve or a spectrum, not a matrix of heights.
_LONGEST_OF_TWO = 8
# Heights in metres are below this limit [m]; greater values must be in another unit.
_HIGHEST_M = 1e-4
_HEIGHT_NAMES = re.compile(r"height|topo|\bz\b|z_?sensor", re.IGNORECASE)


class _Channel(NamedTuple):
    """One map of a file: name, values with y rising, width and depth, and the units of both as the file has them."""

    name: str
    values: npt.NDArray[np.generic]
    width: float
    depth: float
    unit_xy: str
    unit_z: str


def read_surface(
    path: Path, channel: str | None = None, size_m: float | None = None, *, may_lack: bool = False
) -> Surface:
    """Return the height map in a file.

    Args:
        path: The file.
        channel: A part of the name of one of several channels; None takes the first that is a height.
        size_m: The width of a map in a .npy file (square, heights in metres) or a text table that lacks it [m].
        may_lack: Whether heights may be missing; they are NaN then.

    Raises:
        ConfigError: The file cannot be used; the message names it and what is wrong with it.
    """
    read = _READERS.get(path.suffix.lower(), _read_by_package)
    if size_m is not None and path.suffix.lower() not in (".npy", *_TEXTS):
        raise ConfigError(f"{path}: states its size itself; give a size for .npy files and text tables only")
    try:
        surface = _chosen(read(path, size_m), channel)
        scale = _metres(surface.unit_z, f"the heights of channel {surface.name}")
        side = _metres(surface.unit_xy, f"the sides of channel {surface.name}")
        heights = surface.values.astype(np.float64) * scale
        return checked(heights, surface.width * side, surface.depth * side, may_lack=may_lack)
    except ConfigError:
        raise
    except OSError as error:
        near = "" if path.suffix or path.name != str(path) else probably_meant(path.name, SHAPES)
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}{near}") from error
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error
    # A damaged file may make a reader raise anything.
    except Exception as error:
        raise ConfigError(f"{path}: is not a complete height map: {described(error)}") from error


def _metres(unit: str, what: str) -> float:
    unit_read = unit_of(unit)
    if unit_read is None or unit_read.powers != _LENGTH:
        raise ValueError(
            f"the unit of {what} is {repr(unit) if unit else 'none'}; it must be a length: {', '.join(METRES)}"
        )
    return unit_read.factor


def _chosen(channels: list[_Channel], wanted: str | None) -> _Channel:
    names = ", ".join(c.name for c in channels)
    if not channels:
        raise ValueError("has no channel with a map")
    if wanted is not None:
        matching = [c for c in channels if wanted.lower() in c.name.lower()]
        if not matching:
            raise ValueError(f"has no channel {wanted!r}; it has: {names}")
        return matching[0]
    heights = [c for c in channels if (unit := unit_of(c.unit_z)) and unit.powers == _LENGTH] or channels
    return next((c for c in heights if _HEIGHT_NAMES.search(c.name)), heights[0])


def _read_npy(path: Path, size_m: float | None) -> list[_Channel]:
    if size_m is None:
        raise ValueError("a .npy file has heights in metres and no size: give the side of the map (--size)")
    with open_regular(path) as file:
        version = npy.read_magic(file)
        if version not in _NPY_HEADERS:
            raise ValueError(f"is a .npy file of version {version[0]}.{version[1]}, which is not read")
        shape, _, kind = _NPY_HEADERS[version](file)
        if kind.kind not in "fiu":
            raise ValueError("holds no array of numbers")
        stated, actual = math.prod(shape) * kind.itemsize, os.fstat(file.fileno()).st_size - file.tell()
        if min(shape, default=0) < 0 or stated != actual:
            raise ValueError(
                f"has {actual} bytes of heights; the shape {shape} with {kind.itemsize} bytes each needs {stated}"
            )
        if len(shape) == 2 and shape[0] != shape[1]:
            raise ValueError(f"has the shape {shape}; with one side given, it must be square")
        _check_pixels(shape)
        file.seek(0)
        values = npy.read_array(file, allow_pickle=False)[::-1]
    return [_Channel("heights", values, size_m, size_m, "m", "m")]


def _read_text(path: Path, size_m: float | None) -> list[_Channel]:
    """Read a matrix of heights in text: rows from the top down; a head may say its sizes and the unit of its values."""
    try:
        table = TextTable.read(path)
    except ConfigError:
        # Not a plain table: a package may know the format.
        return _read_by_package(path, size_m)
    if len(table.columns) == 2 and len(table.lines) > _LONGEST_OF_TWO:
        raise ValueError(f"is a table of two columns and {len(table.lines)} rows, not a matrix of heights")
    values = np.array([table.numbers(column) for column in table.columns]).T[::-1]
    _check_pixels(values.shape)
    stated = {
        key: matches[0]
        for key, words in _HEAD_PATTERNS.items()
        if (matches := re.findall(words, "\n".join(table.head)))
    }
    sides = [
        (as_number(stated[key][0]) or 0.0) * _metres(stated[key][1], f"the {key} in its head")
        if key in stated
        else None
        for key in ("width", "height")
    ]
    width = sides[0] if size_m is None else size_m
    if width is None:
        raise ValueError(
            "is a matrix of heights without a size: give its width (--size), or write `# Width: 1 µm` above"
        )
    # Without a depth in the head, pixels are square.
    depth = sides[1] if size_m is None and sides[1] is not None else width * len(values) / len(values[0])
    if "values" not in stated and not np.nanmax(np.abs(values)) < _HIGHEST_M:
        raise ValueError("its values are not heights in m: write their unit above them, as in `# Value units: nm`")
    return [_Channel("heights", values, width, depth, "m", stated.get("values", "m"))]


def _check_pixels(shape: tuple[int, ...]) -> None:
    if len(shape) != 2 or not all(2 <= side <= MOST_PIXELS for side in shape):
        raise ValueError(f"has the shape {shape}; a height map has 2 to {MOST_PIXELS} rows and columns")


def _read_gsf(path: Path, size_m: float | None) -> list[_Channel]:
    with open_regular(path) as file:
        head = file.read(_LONGEST_GSF_HEADER)
        if not head.startswith(GSF_MAGIC):
            raise ValueError(f"does not begin with {GSF_MAGIC.decode().strip()!r}: is not a Gwyddion Simple Field")
        end = head.find(b"\0")
        if end < 0:
            raise ValueError(f"its header has no end (a zero byte) within {_LONGEST_GSF_HEADER} bytes")
        header: dict[str, str] = {}
        for line in head[len(GSF_MAGIC) : end].decode("utf-8", "replace").splitlines():
            key, sign, value = line.partition("=")
            if not sign:
                raise ValueError(f"its header has the line {line!r}, which must be KEY = VALUE")
            header[key.strip()] = value.strip()
        columns, rows = (_whole(header, key) for key in ("XRes", "YRes"))
        start = end + 4 - end % 4
        actual, stated = os.fstat(file.fileno()).st_size - start, 4 * columns * rows
        if actual != stated:
            raise ValueError(f"has {actual} bytes of heights; {columns} x {rows} values of 4 bytes need {stated}")
        file.seek(start)
        values = np.frombuffer(file.read(stated), "<f4").reshape(rows, columns)[::-1]
    width, depth = (_real(header, key) for key in ("XReal", "YReal"))
    return [
        _Channel(
            header.get("Title", "heights"), values, width, depth, header.get("XYUnits", ""), header.get("ZUnits", "")
        )
    ]


def _whole(header: Mapping[str, str], key: str) -> int:
    if not re.fullmatch(r"\d{1,6}", header.get(key, "")) or not 2 <= int(header[key]) <= MOST_PIXELS:
        raise ValueError(f"{key} is {header.get(key, 'missing')}; it must be a whole number from 2 to {MOST_PIXELS}")
    return int(header[key])


def _real(header: Mapping[str, str], key: str) -> float:
    value = as_number(header.get(key, "missing"))
    if value is None or not value > 0.0:
        raise ValueError(f"{key} is {header.get(key, 'missing')}; it must be the length of that side, above 0")
    return value


def _read_by_package(path: Path, size_m: float | None) -> list[_Channel]:
    image, maps = read_by_package(path, "heights")
    for values in maps:
        _check_pixels(values.shape)
    return [
        _Channel(fact["name"], values, fact["sides"][0], fact["sides"][1], fact["unit"], fact["z"])
        for fact, values in zip(image["channels"], maps, strict=True)
    ]


_READERS: dict[str, Callable[[Path, float | None], list[_Channel]]] = {
    ".npy": _read_npy,
    ".gsf": _read_gsf,
    **dict.fromkeys(_TEXTS, _read_text),
}

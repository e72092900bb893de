"""Height maps from files of other instruments and programs: .gsf, .gwy, .ibw, .npy.

Rows in a file run from the top of the picture down, except in Igor's waves, which run from the bottom; here y rises
with the row. The readers of .gwy and .ibw are those that their fields use (`gwyfile`, `igor2`), imported when such a
file is read.
"""

import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from proto.errors import ConfigError
from services.afm_node.surface import MOST_PIXELS, Surface, checked

GSF_MAGIC = b"Gwyddion Simple Field 1.0\n"
# metres in a unit of length, as files write it
_METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9, "pm": 1e-12, "Å": 1e-10}
_HEIGHT_NAMES = ("height", "topograph", "zsensor", "z sensor", "z_sensor")


class _Channel(NamedTuple):
    """One map of a file: name, values with y rising, width and depth, and the units of both as the file has them."""

    name: str
    values: npt.NDArray[np.generic]
    width: float
    depth: float
    unit_xy: str
    unit_z: str


def read_surface(path: Path, channel: str | None = None, size_m: float | None = None) -> Surface:
    """Return the height map in a file.

    Parameters: channel, part of the name of one of several; without it the first that is a height. size_m [m], the side
    of a square map in a .npy file, which does not say it itself; its heights are metres.
    Raises: ConfigError naming the file and what is wrong with it.
    """
    read = _READERS.get(path.suffix.lower())
    if read is None:
        raise ConfigError(f"{path}: is no height map that can be read; these are {', '.join(sorted(_READERS))}")
    if size_m is not None and path.suffix.lower() != ".npy":
        raise ConfigError(f"{path}: says its own size; a size is given for .npy files only")
    try:
        found = _chosen(read(path, size_m), channel)
        scale = _metres(found.unit_z, f"the heights of channel {found.name}")
        side = _metres(found.unit_xy, f"the sides of channel {found.name}")
        return checked(found.values.astype(np.float64) * scale, found.width * side, found.depth * side)
    except ImportError as error:
        raise ConfigError(f"{path}: needs {error.name} to be read: pip install 'telenano[instrument]'") from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, EOFError) as error:
        raise ConfigError(f"{path}: {error}") from error


def _metres(unit: str, what: str) -> float:
    if unit not in _METRES:
        said = f"{unit!r}" if unit else "none"
        raise ValueError(f"the unit of {what} is {said}; it must be a length: {', '.join(_METRES)}")
    return _METRES[unit]


def _chosen(channels: list[_Channel], wanted: str | None) -> _Channel:
    names = ", ".join(c.name for c in channels)
    if not channels:
        raise ValueError("has no channel with a map")
    if wanted is not None:
        found = [c for c in channels if wanted.lower() in c.name.lower()]
        if not found:
            raise ValueError(f"has no channel {wanted!r}; it has: {names}")
        return found[0]
    heights = [c for c in channels if c.unit_z in _METRES] or channels
    return next((c for c in heights if any(name in c.name.lower() for name in _HEIGHT_NAMES)), heights[0])


def _read_npy(path: Path, size_m: float | None) -> list[_Channel]:
    values: Any = np.load(path, allow_pickle=False)
    if size_m is None:
        raise ValueError("a .npy file has heights in metres and no size: give the side of the map (--size)")
    if not isinstance(values, np.ndarray) or values.dtype.kind not in "fiu":
        raise ValueError("holds no array of numbers")
    if values.ndim == 2 and values.shape[0] != values.shape[1]:
        raise ValueError(f"has the shape {values.shape}; with one side given, it must be square")
    return [_Channel("heights", values, size_m, size_m, "m", "m")]


def _read_gsf(path: Path, size_m: float | None) -> list[_Channel]:
    content = path.read_bytes()
    if not content.startswith(GSF_MAGIC):
        raise ValueError(f"does not begin with {GSF_MAGIC.decode().strip()!r}: is no Gwyddion Simple Field")
    end = content.find(b"\0")
    if end < 0:
        raise ValueError("its header has no end (a zero byte)")
    header: dict[str, str] = {}
    for line in content[len(GSF_MAGIC) : end].decode("utf-8", "replace").splitlines():
        key, sign, value = line.partition("=")
        if not sign:
            raise ValueError(f"its header has the line {line!r}, which must be KEY = VALUE")
        header[key.strip()] = value.strip()
    columns, rows = (_whole(header, key) for key in ("XRes", "YRes"))
    data = content[end + 4 - end % 4 :]
    if len(data) != 4 * columns * rows:
        raise ValueError(f"has {len(data)} bytes of heights; {columns} x {rows} of 4 bytes are {4 * columns * rows}")
    values = np.frombuffer(data, "<f4").reshape(rows, columns)[::-1]
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
    try:
        value = float(header[key])
    except (KeyError, ValueError):
        raise ValueError(f"{key} is {header.get(key, 'missing')}; it must be the length of that side") from None
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{key} is {value}; it must be positive and finite")
    return value


def _read_gwy(path: Path, size_m: float | None) -> list[_Channel]:
    import gwyfile
    from gwyfile.objects import GwyDataField

    content = path.read_bytes()
    begin = content.find(b"\0") + 5
    # the reader would look for the end of a truncated file for ever
    length = int.from_bytes(content[begin - 4 : begin], "little")
    if content[:4] != b"GWYP" or begin < 9 or len(content) - begin != length:
        raise ValueError("is no whole Gwyddion file: it must begin with GWYP and have the length that it says")
    try:
        container = gwyfile.load(str(path))
    except OSError:
        raise
    # the reader fails in whatever way the damage leads it to
    except Exception as error:
        raise ValueError(f"is no whole Gwyddion file: {error}") from error
    channels = []
    for key in sorted(key for key in container if re.fullmatch(r"/\d+/data", key)):
        field = container[key]
        if isinstance(field, GwyDataField):
            name = str(container.get(f"{key}/title", key))
            units = (str(getattr(field.get(k), "unitstr", "") or "") for k in ("si_unit_xy", "si_unit_z"))
            channels.append(_Channel(name, np.asarray(field.data)[::-1], field.xreal, field.yreal, *units))
    return channels


def _read_ibw(path: Path, size_m: float | None) -> list[_Channel]:
    from igor2 import binarywave

    try:
        wave = binarywave.load(str(path))["wave"]
        values, header = wave["wData"], wave["wave_header"]
        scale, unit_z = header["sfA"], _text(header["dataUnits"])
        units = [_text(row) for row in header["dimUnits"][:2]]
        labels = [_text(label) for label in wave["labels"][2][1:]]
    except OSError:
        raise
    except Exception as error:
        raise ValueError(f"is no whole Igor binary wave with a map: {error}") from error
    if values.ndim not in (2, 3):
        raise ValueError(f"has the shape {values.shape}; a map has rows and columns")
    if units[0] != units[1]:
        raise ValueError(f"its sides have different units, {units[0]!r} and {units[1]!r}")
    columns, rows = values.shape[:2]
    layers = values.reshape(columns, rows, -1)
    # the unit of the wave is that of its first layers; those that are no heights say so by their names
    return [
        _Channel(name, layers[:, :, i].T, columns * scale[0], rows * scale[1], units[0], _layer_unit(name, unit_z))
        for i, name in enumerate((*labels, *(f"layer {i}" for i in range(len(labels), layers.shape[2]))))
        if i < layers.shape[2]
    ]


def _layer_unit(name: str, unit: str) -> str:
    other = {"phase": "deg", "potential": "V", "deflvolts": "V"}
    return next((found for part, found in other.items() if part in name.lower()), unit)


def _text(parts: Any) -> str:
    """Return a text of an Igor header, which is bytes or single characters of them."""
    return (parts if isinstance(parts, bytes) else b"".join(parts)).decode("latin-1").strip("\0 ")


_READERS: dict[str, Callable[[Path, float | None], list[_Channel]]] = {
    ".npy": _read_npy,
    ".gsf": _read_gsf,
    ".gwy": _read_gwy,
    ".ibw": _read_ibw,
}

"""Igor's binary waves (.ibw, version 5), by `igor2` in a child process, after their sizes were compared with the file.

Format: WaveMetrics, Technical Note 003. `igor2` takes the memory that the header asks for before it looks at the data.
"""

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from presets.regular_files import open_regular

_VERSION = 5
_DATA_START = 384
# The lengths of the parts behind the data: formula, note, units, labels of dimensions, indices, two options.
_PARTS = struct.Struct("8x14i")
_POINTS, _TYPE, _DIMENSIONS = 76, 80, 132
_ITEM_BYTES = {0x02: 4, 0x04: 8, 0x08: 1, 0x10: 2, 0x20: 4}
_COMPLEX, _UNSIGNED = 0x01, 0x40

Found = tuple[dict[str, Any], list[npt.NDArray[Any]]]


def require_whole(path: Path) -> None:
    """Raise ValueError where a file is no wave of version 5, or states sizes that it does not have; OSError."""
    with open_regular(path) as file:
        head = file.read(_DATA_START)
        size = file.seek(0, 2)
    order = next((each for each in "<>" if len(head) == _DATA_START and _read("h", each, head, 0) == (_VERSION,)), "")
    if not order:
        raise ValueError(f"it is no Igor binary wave of version {_VERSION}")
    (points,), (kind,) = _read("i", order, head, _POINTS), _read("h", order, head, _TYPE)
    sides = [side for side in _read("4i", order, head, _DIMENSIONS) if side != 0]
    item = _ITEM_BYTES.get(kind & ~(_COMPLEX | _UNSIGNED), 0) * (2 if kind & _COMPLEX else 1)
    if not item:
        raise ValueError(f"it is no Igor binary wave of numbers (type {kind})")
    if min([points, *sides]) < 0 or math.prod(sides) != points or _DATA_START + points * item > size:
        shape = " x ".join(map(str, sides)) or "0"
        raise ValueError(
            f"it is no whole Igor binary wave: {shape} numbers of {item} bytes, {points} in all, of {size}"
        )
    parts = struct.unpack_from(order + _PARTS.format, head)
    if min(parts) < 0 or _DATA_START + points * item + sum(parts) > size:
        raise ValueError(f"it is no whole Igor binary wave: its note, units and labels go beyond its {size} bytes")


def _read(form: str, order: str, head: bytes, place: int) -> tuple[int, ...]:
    return struct.unpack_from(order + form, head, place)


def load_wave(path: str) -> Found:
    """Return a wave as plain values and its array, shape as in Igor; called in a child.

    Values: unit of the data, units and steps of the first two dimensions, labels of each dimension, and the note.
    """
    from igor2 import binarywave

    wave = binarywave.load(path)["wave"]
    header = wave["wave_header"]
    facts = {
        "unit": _text(header["dataUnits"]),
        "units": [_text(row) for row in header["dimUnits"][:2]],
        "steps": [float(step) for step in header["sfA"][:2]],
        "labels": [[_text(label) for label in labels[1:]] for labels in wave["labels"]],
        "note": _text(wave["note"]),
    }
    values = np.asarray(wave["wData"])
    if values.dtype.kind not in "fiu":
        raise ValueError("its values are no numbers")
    return facts, [values]


def _text(parts: Any) -> str:
    """Return a text of an Igor header, which is bytes or single characters of them."""
    return (parts if isinstance(parts, bytes) else b"".join(parts)).decode("latin-1").strip("\0 ")

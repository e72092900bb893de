"""Read Igor's binary waves (.ibw, version 5) with `igor2`, after checking their sizes; called in a child process.

Format: WaveMetrics, Technical Note 003. `igor2` allocates the memory that the header asks for before it looks at the
data, so the sizes are first compared with the file.
"""

import math
import re
import struct
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from telenano.files import open_regular
from telenano_lab.afm_files.map_libraries import refusal_of_pause
from telenano_lab.afm_files.recorded import Curves, RecordedCurve

_VERSION = 5
_DATA_START = 384
# Lengths of the parts behind the data: formula, note, units, labels of dimensions, indices, two options.
_PARTS = struct.Struct("8x14i")
# Offsets in the header of a wave [bytes].
_POINTS = 76
_TYPE = 80
_DIMENSIONS = 132
_ITEM_BYTES = {0x02: 4, 0x04: 8, 0x08: 1, 0x10: 2, 0x20: 4}
# Flags of the type of a wave.
_COMPLEX = 0x01
_UNSIGNED = 0x40

Found = tuple[dict[str, Any], list[npt.NDArray[Any]]]


def require_whole(path: Path) -> None:
    """Raise ValueError if a file is no wave of version 5 or smaller than its header states; OSError if unreadable."""
    with open_regular(path) as file:
        head = file.read(_DATA_START)
        size = file.seek(0, 2)
    order = next((each for each in "<>" if len(head) == _DATA_START and _read("h", each, head, 0) == (_VERSION,)), "")
    if not order:
        raise ValueError(f"it is not an Igor binary wave of version {_VERSION}")
    (points,), (kind,) = _read("i", order, head, _POINTS), _read("h", order, head, _TYPE)
    sides = [side for side in _read("4i", order, head, _DIMENSIONS) if side != 0]
    item = _ITEM_BYTES.get(kind & ~(_COMPLEX | _UNSIGNED), 0) * (2 if kind & _COMPLEX else 1)
    if not item:
        raise ValueError(f"it is not an Igor binary wave of numbers (type {kind})")
    if min([points, *sides]) < 0 or math.prod(sides) != points or _DATA_START + points * item > size:
        shape = " x ".join(map(str, sides)) or "0"
        raise ValueError(
            f"it is not a complete Igor binary wave: {shape} numbers of {item} bytes, {points} in all, of {size}"
        )
    parts = struct.unpack_from(order + _PARTS.format, head)
    if min(parts) < 0 or _DATA_START + points * item + sum(parts) > size:
        raise ValueError(
            f"it is not a complete Igor binary wave: its note, units and labels go beyond its {size} bytes"
        )


def _read(form: str, order: str, head: bytes, place: int) -> tuple[int, ...]:
    return struct.unpack_from(order + form, head, place)


def load_wave(path: str) -> Found:
    """Return the facts of a wave as plain values, and its array, shape as in Igor.

    Facts: unit of the data, units and steps of the first two dimensions, labels of each dimension, and the note.
    """
    from igor2 import binarywave

    require_whole(Path(path))
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
        raise ValueError("its values are not numbers")
    return facts, [values]


def load_maps(path: str) -> Found:
    """Return the maps of a wave; y rises with the row, and columns are Igor's rows.

    Facts: `channels`, for each map its name, its width and depth, and the units of both and of the values.
    """
    wave, (values,) = load_wave(path)
    if values.ndim not in (2, 3):
        raise ValueError(f"has the shape {values.shape}; a map has rows and columns")
    if wave["units"][0] != wave["units"][1]:
        raise ValueError(f"its sides have different units, {wave['units'][0]!r} and {wave['units'][1]!r}")
    columns, rows = values.shape[:2]
    layers, labels, (dx, dy) = values.reshape(columns, rows, -1), wave["labels"][2], wave["steps"]
    count = layers.shape[2]
    names = [*labels, *(f"layer {i}" for i in range(len(labels), count))][:count]
    # The unit of the wave is that of its first layers; layers that are no heights say so in their names.
    facts = [
        {"name": name, "sides": [columns * dx, rows * dy], "unit": wave["units"][0], "z": _unit(name, wave["unit"])}
        for name in names
    ]
    return {"channels": facts}, [layers[:, :, i].T for i in range(count)]


def _unit(name: str, unit: str) -> str:
    other = {"phase": "deg", "potential": "V", "deflvolts": "V"}
    return next((unit_of_part for part, unit_of_part in other.items() if part in name.lower()), unit)


def curves_of(path: str) -> Curves:
    """Return the force curve in a wave of Asylum's (columns Defl, and ZSnsr or Raw)."""
    wave, (values,) = load_wave(path)
    if values.ndim != 2:
        raise ValueError(f"it has the shape {values.shape}; a curve has rows and columns")
    columns = dict(zip(wave["labels"][1], np.asarray(values, dtype=np.float64).T, strict=True))
    if wave["unit"] != "m":
        raise ValueError("its values are not lengths in m")
    notes = notes_of(wave)
    for names in (("Defl",), ("ZSnsr", "Raw")):
        if not any(name in columns for name in names):
            raise ValueError(f"it has no column {' or '.join(names)}")
    if "Indexes" not in notes:
        raise ValueError("its note lacks Indexes")
    # A segment that dwells has the direction 0, not 1 (towards the sample) or -1 (away).
    if "0" in (way.strip() for way in notes.get("Direction", "").split(",")):
        raise ValueError(refusal_of_pause("a dwell at the sample"))
    # The base rises towards the sample, as the deflection and Asylum's sensor do.
    base = columns["ZSnsr"] if "ZSnsr" in columns else columns["Raw"]
    # The ends of the segments; a curve that dwells has more than two.
    ends = [int(float(end)) + 1 for end in notes["Indexes"].split(",") if end]
    turn, back = ends[1], ends[-2]
    speed = abs(float(base[turn - 1] - base[0])) / (float(wave["steps"][0]) * turn)
    ways = tuple((-base[way], columns["Defl"][way]) for way in (slice(None, turn), slice(back, None)))
    k, sensitivity = (float(notes[name]) if name in notes else None for name in ("SpringConstant", "InvOLS"))
    return Curves((1, 1), (0.0, 0.0), iter([(lambda: RecordedCurve((0, 0), ways, "m", k, sensitivity, speed), 1.0)]))


def curves_of_folder(path: str) -> Curves:
    """Return the curves of a map of Asylum's saved as a folder of waves, each named as `Line0003Point0012.ibw`."""
    curves = {}
    for file in sorted(Path(path).glob("*.ibw")):
        if place := re.search(r"Line(\d+)Point(\d+)", file.stem, re.IGNORECASE):
            curves[int(place[2]), int(place[1])] = file
    if not curves:
        raise ValueError("is a folder without the waves of a map, which are named as Line0003Point0012.ibw")
    notes = notes_of(load_wave(str(next(iter(curves.values()))))[0])
    sides = [float(notes.get(f"{axis}ScanSize", notes.get("ScanSize", 0.0))) for axis in ("Fast", "Slow")]
    shape = tuple(max(1 + place[axis] for place in curves) for axis in (0, 1))

    def curve(place: tuple[int, int], file: Path) -> RecordedCurve:
        try:
            (read, _), *_ = curves_of(str(file)).each
            return read()._replace(place=place)
        except ValueError as error:
            raise ValueError(f"{file.name}: {error}") from error

    shares = ((partial(curve, *each), (number + 1) / len(curves)) for number, each in enumerate(curves.items()))
    return Curves((shape[0], shape[1]), (sides[0], sides[1]), shares)


def notes_of(wave: dict[str, Any]) -> dict[str, str]:
    """Return the lines of the note of a wave as a dict."""
    return dict(line.partition(":")[::2] for line in wave["note"].split("\r"))


def _text(parts: Any) -> str:
    """Decode a text of an Igor header, which is bytes or single characters of them."""
    return (parts if isinstance(parts, bytes) else b"".join(parts)).decode("latin-1").strip("\0 ")

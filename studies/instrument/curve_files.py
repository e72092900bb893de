"""Force curves by the libraries of the field (`h5py`, `afmformats`): called in a child process with limits.

Each function returns spring constant k [N/m] and speed of the approach [m/s] by name, and the arrays force [N], height
[m], which rises away from the sample, and number of the segment.
"""

import logging
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from services.afm_node.physics.sample.map_libraries import (
    blocks_of,
    refuse_large_archive,
    require_force_curve,
    ways_of,
)

# A curve has so many points at most; at a megahertz that is a quarter of a minute.
_MOST_POINTS = 1 << 24
_MOST_UNPACKED_BYTES = 1 << 30

Found = tuple[dict[str, float], list[npt.NDArray[Any]]]


def load_hdf5(path: str) -> Found:
    """Return the first curve of a file as `write_hdf5` and afmformats write it."""
    import h5py

    with h5py.File(path, "r") as file:
        group = _part(file, "0", h5py.Group)
        require_force_curve(group.attrs)
        if "spring constant" not in group.attrs:
            raise ValueError("its metadata lack the spring constant")
        facts = {"k": _number(group, "spring constant"), "speed": 1.0}
        if "speed approach" in group.attrs:
            facts["speed"] = _number(group, "speed approach")
        columns = [_part(group, name, h5py.Dataset) for name in ("force", "height (measured)", "segment")]
        for column in columns:
            # a few bytes may state a column of any length, which was never written
            if column.ndim != 1 or column.size > _MOST_POINTS or column.dtype.kind not in "fiu":
                shape = f"{column.dtype} of shape {column.shape}"
                raise ValueError(f"its {column.name} is {shape}; it must be up to {_MOST_POINTS} numbers in a row")
        if len({column.size for column in columns}) != 1:
            raise ValueError(f"its columns have {', '.join(str(column.size) for column in columns)} points")
        return facts, [np.asarray(column[()], dtype=np.float64) for column in columns]


def _part(group: Any, name: str, kind: type) -> Any:
    found = group.get(name)
    if not isinstance(found, kind):
        raise ValueError(f"it has no {kind.__name__.lower()} {name!r}")
    return found


def _number(group: Any, name: str) -> float:
    value = group.attrs[name]
    if np.size(value) != 1:
        raise ValueError(f"its {name} is no number")
    return float(np.asarray(value).reshape(()))


def load_afmformats(path: str, number: str = "0") -> Found:
    """Return a curve of a file that afmformats reads, by its number; the first is 0."""
    import afmformats
    from afmformats.errors import MissingMetaDataError

    _prepare(path)
    wanted = int(number)
    try:
        with tempfile.TemporaryDirectory() as folder:
            for block, _ in blocks_of(path, Path(folder)):
                curves = afmformats.load_data(block)
                if wanted < len(curves):
                    return _columns_of(curves[wanted])
                wanted -= len(curves)
    except MissingMetaDataError as error:
        raise ValueError(f"its metadata lack {', '.join(map(str, error.meta_keys))}") from error
    raise ValueError(f"it has no curve {number}; it has {int(number) - wanted}, and the first is 0")


def _columns_of(found: Any) -> Found:
    require_force_curve(found.metadata)
    if "spring constant" not in found.metadata:
        raise ValueError("its metadata lack the spring constant")
    facts = {"k": float(found.metadata["spring constant"]), "speed": float(found.metadata.get("speed approach", 1))}
    height = found["height (measured)"] if "height (measured)" in found else found["height (piezo)"]
    columns = [np.asarray(column, dtype=np.float64) for column in (found["force"], height, found["segment"])]
    if len({len(column) for column in columns}) != 1 or not len(columns[0]):
        raise ValueError(f"its columns have {', '.join(str(len(column)) for column in columns)} points")
    return facts, columns


def load_deflections(path: str) -> Found:
    """Return the approaches of a file of curves, of a large map those of its first block.

    Arrays: how many points each has; then, of all one after another, height [m] and deflection as it was read [V].
    """
    import afmformats

    _prepare(path)
    # The forces of other formats were computed before, by constants that stand in the file.
    is_raw = ".jpk-" in path.lower()
    counts, heights, volts = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        block, _ = next(blocks_of(path, Path(folder)))
        # With constants of 1 the force of a file of JPK is the voltage itself.
        given = {"spring constant": 1.0, "sensitivity": 1.0} if is_raw else {}
        for curve in afmformats.load_data(block, meta_override=given):
            require_force_curve(curve.metadata)
            if lacks := [key for key in ("spring constant", "sensitivity") if key not in curve.metadata]:
                raise ValueError(f"its metadata lack {', '.join(lacks)}: the voltage that was read cannot be told")
            height, force = ways_of(curve)[0]
            counts.append(len(height))
            heights.append(height)
            volts.append(force / (curve.metadata["spring constant"] * curve.metadata["sensitivity"]))
    return {}, [np.array(counts), np.concatenate(heights), np.concatenate(volts)]


def _prepare(path: str) -> None:
    # afmformats reports with a traceback what it raises as well
    logging.getLogger("afmformats").setLevel(logging.CRITICAL)
    if path.lower().endswith(".jpk-force"):
        refuse_large_archive(path, _MOST_UNPACKED_BYTES)
    else:
        refuse_large_archive(path)

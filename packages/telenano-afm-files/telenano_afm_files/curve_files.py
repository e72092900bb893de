"""Force curves by `afmformats`: called in a child process with limits.

A curve is its spring constant [N/m], speed [m/s] and points of the approach by name, and the arrays base and deflection
[m].
"""

import logging
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from telenano_afm_files.igor_waves import load_wave, notes_of, refuse_dwell, refuse_number
from telenano_afm_files.map_libraries import blocks_of, curves_of, refuse_large_archive, require_force_curve, ways_of

_MOST_UNPACKED_BYTES = 1 << 30

Array = npt.NDArray[np.float64]
Found = tuple[dict[str, Any], list[npt.NDArray[Any]]]


def load_afmformats(path: str, number: str) -> Found:
    """Return the first curve of a file that afmformats reads."""
    refuse_number(number)
    return load_one_of_map(path, number)


def load_one_of_map(path: str, number: str) -> Found:
    """Return a curve of a map that afmformats reads, by its number; the first is 0."""
    from afmformats.errors import MissingMetaDataError

    _prepare(path)
    wanted = int(number)
    try:
        with tempfile.TemporaryDirectory() as folder:
            for block, _ in blocks_of(path, Path(folder)):
                curves = curves_of(block)
                if wanted < len(curves):
                    return _columns_of(curves[wanted])
                wanted -= len(curves)
    except MissingMetaDataError as error:
        raise ValueError(f"its metadata lack {', '.join(map(str, error.meta_keys))}") from error
    raise ValueError(f"it has no curve {number}; it has {int(number) - wanted}, and the first is 0")


def _columns_of(found: Any) -> Found:
    require_force_curve(found)
    if "spring constant" not in found.metadata:
        raise ValueError("its metadata lack the spring constant")
    height = found["height (measured)"] if "height (measured)" in found else found["height (piezo)"]
    columns = [np.asarray(column, dtype=np.float64) for column in (found["force"], height, found["segment"])]
    if len({len(column) for column in columns}) != 1 or not len(columns[0]):
        raise ValueError(f"its columns have {', '.join(str(len(column)) for column in columns)} points")
    return _curve(float(found.metadata["spring constant"]), float(found.metadata.get("speed approach", 1)), *columns)


def _curve(k: float, speed: float, force: Array, height: Array, segment: Array) -> Found:
    """Return the first and the last segment of a curve, whose height rises away from the sample."""
    if not 0.0 < k < math.inf:
        raise ValueError(f"its spring constant is {k:g} N/m; it must be above 0 N/m")
    if not len(segment) or segment[0] == segment[-1]:
        raise ValueError("it needs an approach and a retraction")
    first, last = segment == segment[0], segment == segment[-1]
    kept = first | last
    facts = {"stiffness_n_per_m": k, "speed_m_per_s": speed, "turn": int(np.count_nonzero(first))}
    return facts, [-height[kept], force[kept] / k]


def load_deflections(path: str) -> Found:
    """Return the approaches of a file of curves, of a large map those of its first block.

    Arrays: how many points each has; then, of all one after another, height [m] and deflection as it was read [V].
    """
    _prepare(path)
    if path.lower().endswith(".ibw"):
        refuse_dwell(notes_of(load_wave(path)[0]))
    # The forces of other formats were computed before, by constants that stand in the file.
    is_raw = ".jpk-" in path.lower()
    counts, heights, volts = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        block, _ = next(blocks_of(path, Path(folder)))
        # With constants of 1 the force of a file of JPK is the voltage itself.
        given = {"spring constant": 1.0, "sensitivity": 1.0} if is_raw else {}
        for curve in curves_of(block, given):
            require_force_curve(curve)
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

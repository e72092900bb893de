"""Force curves by the libraries of the field (`h5py`, `afmformats`): called in a child process with limits.

Each function returns spring constant k [N/m] and speed of the approach [m/s] by name, and the arrays force [N], height
[m], which rises away from the sample, and number of the segment.
"""

import logging
import zipfile
from typing import Any

import numpy as np
import numpy.typing as npt

# of a curve; at a megahertz that is a quarter of a minute
_MOST_POINTS = 1 << 24
_MOST_UNPACKED_BYTES = 1 << 30

Found = tuple[dict[str, float], list[npt.NDArray[Any]]]


def load_hdf5(path: str) -> Found:
    """Return the first curve of a file as `write_hdf5` and afmformats write it."""
    import h5py

    with h5py.File(path, "r") as file:
        group = _part(file, "0", h5py.Group)
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


def load_afmformats(path: str) -> Found:
    """Return the first curve of a file that afmformats reads."""
    import afmformats
    from afmformats.errors import MissingMetaDataError

    # it reports with a traceback what it raises as well
    logging.getLogger("afmformats").setLevel(logging.CRITICAL)
    if path.lower().endswith(".jpk-force"):
        with zipfile.ZipFile(path) as archive:
            unpacked = sum(each.file_size for each in archive.infolist())
        if unpacked > _MOST_UNPACKED_BYTES:
            raise ValueError(f"it unpacks to {unpacked} bytes, at most {_MOST_UNPACKED_BYTES} are read")
    try:
        found = afmformats.load_data(path)[0]
        if "spring constant" not in found.metadata:
            raise ValueError("its metadata lack the spring constant")
        facts = {"k": float(found.metadata["spring constant"]), "speed": float(found.metadata.get("speed approach", 1))}
        height = found["height (measured)"] if "height (measured)" in found else found["height (piezo)"]
        columns = [np.asarray(column, dtype=np.float64) for column in (found["force"], height, found["segment"])]
    except MissingMetaDataError as error:
        raise ValueError(f"its metadata lack {', '.join(map(str, error.meta_keys))}") from error
    if len({len(column) for column in columns}) != 1 or not len(columns[0]):
        raise ValueError(f"its columns have {', '.join(str(len(column)) for column in columns)} points")
    return facts, columns

"""Read images in HDF5: JPK (.h5-jpk), and NSID of pycroscopy (.h5, .hf5); called in a child process with limits.

JPK stores each channel as integers of shape (points, frames), lowest line first; its `net-encoder` scales them to the
unit of the channel. NSID stores a dataset whose axes are dimension scales with a unit.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Found = tuple[dict[str, Any], list[npt.NDArray[Any]]]


def load_maps(path: str) -> Found:
    """Return the maps of an HDF5 file; y rises with the row.

    Raises:
        ValueError: It has no map of a known kind; the message names the datasets that it has.
    """
    import h5py

    facts: list[dict[str, Any]] = []
    maps: list[Array] = []
    others: list[str] = []
    with h5py.File(path, "r") as file:
        is_jpk = _text(file.attrs.get("file-format-info", "")).startswith("JPK")
        for name, sides, unit, z, values in _jpk(file) if is_jpk else _nsid(file, others):
            facts.append({"name": name, "sides": sides, "unit": unit, "z": z})
            maps.append(values)
    if not maps:
        several = f", …, {len(others)} in all" if len(others) > 6 else ""
        listed = f"; it has {', '.join(others[:6])}{several}" if others else ""
        raise ValueError(
            "has no image of JPK and none of NSID, which has two axes with a unit of length"
            f"{listed}. Export the image as .gsf or .gwy, or as .npy with `--size`"
        )
    return {"channels": facts}, maps


Map = tuple[str, list[float], str, str, Array]


def _jpk(file: Any) -> Iterator[Map]:
    import h5py

    for measurement in file.values():
        grid = {key: measurement.attrs.get(f"position-pattern.grid.{key}") for key in
                ("ilength", "jlength", "ulength", "vlength")}  # fmt: skip
        if None in grid.values():
            continue
        columns, rows = int(grid["ilength"]), int(grid["jlength"])
        for channel in measurement.values():
            if not isinstance(channel, h5py.Group) or "net-encoder.scaling.multiplier" not in channel.attrs:
                continue
            unit, multiplier, offset = (channel.attrs[f"net-encoder.scaling.{key}"] for key in
                                        ("unit.unit", "multiplier", "offset"))  # fmt: skip
            name = _text(channel.attrs.get("channel.fancy-name", channel.name.rpartition("/")[2]))
            way = " retrace" if _text(channel.attrs.get("retrace", "")) == "true" else ""
            for data in channel.values():
                if data.ndim != 2 or data.shape[0] != rows * columns:
                    continue
                for frame in range(data.shape[1]):
                    values = np.asarray(data[:, frame], dtype=np.float64) * float(multiplier) + float(offset)
                    which = f" {frame + 1} of {data.shape[1]}" if data.shape[1] > 1 else ""
                    sides = [float(grid["ulength"]), float(grid["vlength"])]
                    yield f"{name}{way}{which}", sides, "m", _text(unit), values.reshape(rows, columns)


def _nsid(file: Any, others: list[str]) -> Iterator[Map]:
    import h5py

    datasets: list[Any] = []
    file.visititems(lambda name, item: datasets.append(item) if isinstance(item, h5py.Dataset) else None)
    for data in datasets:
        axes = [_axis(data, place) for place in range(data.ndim)] if data.ndim == 2 else []
        if data.attrs.get("CLASS", b"") != b"DIMENSION_SCALE":
            others.append(data.name)
        if len(axes) == 2 and None not in axes and data.dtype.kind in "fiu":
            (length, unit), (other, same) = (axis for axis in axes if axis is not None)
            by_name = [str(data.dims[place].label) for place in (0, 1)]
            values, sides = np.asarray(data, dtype=np.float64), [other, length]
            if unit != same:
                continue
            if by_name == ["x", "y"]:
                values, sides = values.T, sides[::-1]
            name = _text(data.attrs.get("quantity", "")) or data.name.rpartition("/")[2]
            yield name, sides, unit, _text(data.attrs.get("units", "")), values


def _axis(data: Any, place: int) -> tuple[float, str] | None:
    """Return the length of an evenly spaced axis, a point being as wide as a step, and its unit; None otherwise."""
    scale = next(iter(data.dims[place].values()), None)
    if scale is None or scale.shape != (data.shape[place],) or scale.size < 2:
        return None
    points, unit = np.asarray(scale, dtype=np.float64), _text(scale.attrs.get("units", ""))
    step = (points[-1] - points[0]) / (len(points) - 1)
    if not step > 0.0 or np.abs(np.diff(points) - step).max() > 1e-3 * step:
        return None
    return step * len(points), unit


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)

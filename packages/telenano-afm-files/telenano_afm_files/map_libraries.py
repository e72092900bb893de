"""Force maps by the libraries of the field (`afmformats`, `h5py`): called in a child process with limits."""

import logging
import os
import re
import tempfile
import zipfile
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

# Of a segment so many points are kept at most; a finer curve is interpolated to them.
MOST_POINTS = 4096
_MOST_CURVES = 1 << 18
# curves that are read at once
_BLOCK = 64
_MOST_UNPACKED_BYTES = 8 << 30
# Curves pack to a third or a half, and an archive may be so large unpacked besides.
_GREATEST_RATIO, _ORDINARY_BYTES = 32, 64 << 20
# An entry of an archive has a head of so many bytes at least; what all curves share is copied for each block of them.
_LEAST_HEAD, _MOST_SHARED_BYTES = 30, 4 << 20

Found = tuple[dict[str, Any], list[npt.NDArray[Any]]]


def load_grid(path: str) -> Found:
    """Return the members of a plain grid in HDF5: numbers and texts by name, then value, x, y and z."""
    import h5py

    with h5py.File(path, "r") as file:
        names = ("value", "x", "y", "z")
        for name in names:
            if not isinstance(file.get(name), h5py.Dataset):
                raise ValueError(f"{name}: is missing; a plain grid has the datasets value, x, y and z")
            if file[name].size * file[name].dtype.itemsize > 8 << 27:
                raise ValueError(f"{name}: has {file[name].size} values, at most {1 << 27} are read")
        facts = {key: _plain(value) for part in (file, file["value"]) for key, value in part.attrs.items()}
        return facts, [np.asarray(file[name][()]) for name in names]


def _plain(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    return value.item() if isinstance(value, np.generic) else value if isinstance(value, str) else str(value)


def load_curves(path: str, stiffness: str | None, sensitivity: str | None, report: int) -> Found:
    """Return the curves of a file that afmformats reads.

    Facts: shape of the grid, its sides [m] and spring constant [N/m]. Arrays: column and row of each
    curve, points of its approach and its retraction, and all heights [m] and forces [N], one after another.

    Args:
        path: The file.
        stiffness: The spring constant [N/m] in place of that of the file, as text.
        sensitivity: The sensitivity [m/V] likewise.
        report: The descriptor that takes the advance.
    """
    from afmformats.errors import MissingMetaDataError

    # it reports with a traceback what it raises as well
    logging.getLogger("afmformats").setLevel(logging.CRITICAL)
    refuse_large_archive(path)
    names = {"stiffness_n_per_m": "spring constant", "sensitivity_m_per_v": "sensitivity"}
    given = {"spring constant": stiffness, "sensitivity": sensitivity}
    # other formats have forces that were computed before
    is_raw = ".jpk-" in path.lower()
    override = {key: float(value) for key, value in given.items() if value is not None and is_raw}
    facts: dict[str, Any] = {}
    places, counts, columns = [], [], []
    with tempfile.TemporaryDirectory() as folder:
        for block, share in blocks_of(path, Path(folder)):
            try:
                curves = curves_of(block, override)
            except MissingMetaDataError as error:
                missing = [ours for ours, theirs in names.items() if theirs in error.meta_keys]
                text = f"is missing; give it to `telenano sample import` by --set {missing[0]}=…"
                raise ValueError(f"{', '.join(missing)}: {text}") from error
            for curve in curves:
                facts = facts or _facts(curve.metadata)
                places.append([int(curve.metadata.get(f"grid index {axis}", 0)) for axis in "xy"])
                ways = ways_of(curve)
                counts.append([len(way[0]) for way in ways])
                columns += [np.stack(way) for way in ways]
            _tell(report, share)
    if not 0 < len(places) <= _MOST_CURVES:
        raise ValueError(f"it has {len(places)} curves; 1 to {_MOST_CURVES} are read")
    heights, forces = np.concatenate(columns, axis=1)
    return facts, [np.array(places), np.array(counts), heights, forces]


def refuse_large_archive(path: str, most_bytes: int = _MOST_UNPACKED_BYTES) -> None:
    """Raise ValueError for an archive that unpacks to too much, or names bytes twice; another file is no concern."""
    if not zipfile.is_zipfile(path):
        return
    with zipfile.ZipFile(path) as archive:
        found = sorted(archive.infolist(), key=lambda each: each.header_offset)
    most_bytes = min(most_bytes, _ORDINARY_BYTES + _GREATEST_RATIO * Path(path).stat().st_size)
    if (unpacked := sum(each.file_size for each in found)) > most_bytes:
        raise ValueError(f"it unpacks to {unpacked} bytes, at most {most_bytes} are read")
    for one, after in pairwise(found):
        if one.header_offset + _LEAST_HEAD + one.compress_size > after.header_offset:
            raise ValueError(f"its entries {one.filename!r} and {after.filename!r} lie over one another")


def blocks_of(path: str, folder: Path) -> Iterator[tuple[str, float]]:
    """Yield archives with the curves of one, a block of them each, and the share that is done after it.

    To afmformats each curve costs a look at all names of its archive.
    """
    numbers: dict[str, int | None] = {}
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            numbers = {name: _curve_of(name) for name in archive.namelist()}
    of_curve: dict[int, list[str]] = {}
    for name, number in numbers.items():
        if number is not None:
            of_curve.setdefault(number, []).append(name)
    if len(of_curve) <= _BLOCK:
        yield path, 1.0
        return
    # Images and settings of other programs are not looked at.
    shared = [name for name, number in numbers.items() if number is None and name.endswith((".properties", "/"))]
    found = sorted(of_curve)
    with zipfile.ZipFile(path) as archive:
        if (size := sum(archive.getinfo(name).file_size for name in shared)) > _MOST_SHARED_BYTES:
            raise ValueError(f"its curves share {size} bytes of properties, at most {_MOST_SHARED_BYTES} are read")
        for first in range(0, len(found), _BLOCK):
            chosen = found[first : first + _BLOCK]
            block = folder / f"{first}{Path(path).suffix}"
            with zipfile.ZipFile(block, "w") as part:
                for name in [*shared, *(name for number in chosen for name in of_curve[number])]:
                    part.writestr(name, archive.read(name))
            yield os.fspath(block), (first + len(chosen)) / len(found)
            block.unlink()


def _curve_of(name: str) -> int | None:
    head, _, rest = name.partition("/")
    number = rest.partition("/")[0]
    return int(number) if head == "index" and number.isdecimal() else None


def _facts(metadata: Any) -> dict[str, Any]:
    return {
        "shape": [int(metadata.get(f"grid shape {axis}", 1)) for axis in "xy"],
        "sides": [float(metadata.get(f"grid size {axis}", 0.0)) for axis in "xy"],
        "stiffness_n_per_m": float(metadata["spring constant"]) if "spring constant" in metadata else None,
    }


def curves_of(path: str, given: dict[str, float] | None = None) -> Any:
    """Return the curves that afmformats reads; `given` are metadata in place of those of the file.

    Raises:
        ValueError: They pause between approach and retraction, or are no curves that the library knows.
    """
    import afmformats
    from afmformats.errors import FileFormatNotSupportedError

    try:
        return afmformats.load_data(path, meta_override=given or {})
    except FileFormatNotSupportedError as error:
        # The library knows two kinds of pause of JPK's; a file with another is of no format to it.
        if (count := _segments_of(path)) > 2:
            raise ValueError(refusal_of_pause(f"{count} segments")) from error
        raise ValueError(
            "it has no force curves in a form that afmformats reads: export them as HDF5 or .tab"
        ) from error


def _segments_of(path: str) -> int:
    """Return how many segments the longest curve of an archive of JPK's has; 0 for another file."""
    if not zipfile.is_zipfile(path):
        return 0
    with zipfile.ZipFile(path) as archive:
        found = [re.search(r"(?:^|/)segments/(\d{1,6})/", name) for name in archive.namelist()]
    return max((int(each[1]) + 1 for each in found if each), default=0)


def refusal_of_pause(kind: str) -> str:
    """Return why curves of a kind that hold the tip for a while cannot be used."""
    return (
        f"it holds curves of {kind.replace('-', ' ')}, taken over time at a constant force or place, and no force "
        "against distance: give a curve of an approach and a retraction without a pause"
    )


def require_force_curve(curve: Any) -> None:
    """Raise ValueError for a curve of another kind, which is no force against distance however its columns look."""
    mode = str(curve.metadata.get("imaging mode", "")) or "force-distance"
    if mode != "force-distance":
        raise ValueError(refusal_of_pause(mode))
    if len(found := np.unique(np.asarray(curve["segment"]))) > 2:
        raise ValueError(refusal_of_pause(f"{len(found)} segments"))


def ways_of(curve: Any) -> list[tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]]:
    """Return heights [m] and forces [N] of the approach and of the retraction, with the points in order of height.

    Raises:
        ValueError: The curve is one of creep or relaxation.
    """
    require_force_curve(curve)
    height = np.asarray(curve["height (measured)" if "height (measured)" in curve else "height (piezo)"], np.float64)
    force, segment = np.asarray(curve["force"], np.float64), np.asarray(curve["segment"]).astype(int)
    found = []
    for part in (segment == segment[0], segment == segment[-1]):
        z, f = height[part], force[part]
        sound = np.isfinite(z) & np.isfinite(f)
        z, f = z[sound], f[sound]
        order = np.argsort(z, kind="stable")
        z, f = z[order], f[order]
        if len(z) > MOST_POINTS:
            even = np.linspace(z[0], z[-1], MOST_POINTS)
            z, f = even, np.interp(even, z, f)
        found.append((z, f))
    return found


def _tell(report: int, share: float) -> None:
    os.write(report, bytes([min(int(100.0 * share), 100)]))

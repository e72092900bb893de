"""Read force maps with the libraries of the field (`afmformats`, `h5py`); called in a child process with limits."""

import logging
import os
import re
import zipfile
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from telenano_lab.afm_files.recorded import Curves, RecordedCurve, lacks

# Number of curves that are read at once.
_BLOCK = 64
# Largest unpacked size of an archive that is read.
_MOST_UNPACKED_BYTES = 8 << 30
# Largest unpacked size of an archive of one curve.
_MOST_OF_ONE_BYTES = 1 << 30
# An archive may unpack to this multiple of its size; curves compress to a third or a half.
_GREATEST_RATIO = 32
# An archive of any size may unpack to this size.
_ORDINARY_BYTES = 64 << 20
# Least size of the header of an archive's entry [bytes].
_LEAST_HEAD = 30
# Largest size of the properties that all curves share, which are copied for each block of curves.
_MOST_SHARED_BYTES = 4 << 20

# Names of constants in telenano and in afmformats.
_NAMES = {"stiffness_n_per_m": "spring constant", "sensitivity_m_per_v": "sensitivity"}

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


_NO_CURVES = (
    "holds no force curves of the kinds that are known with this ending; packages/telenano-devices/docs/fit.md "
    "(My file) has what is read of each maker: export it as one of these"
)


class NoCurvesError(ValueError):
    """A file in a format that afmformats does not read."""


def curves_of(path: str, folder: Path, constants: dict[str, float]) -> Curves:
    """Return the curves of a file that afmformats reads.

    Args:
        path: The file.
        folder: Folder for the parts of a large archive.
        constants: Constants that replace those of the file, if the file has raw deflections.
    """
    import afmformats
    from afmformats.errors import AFMFileFormatError, FileFormatNotSupportedError, MissingMetaDataError

    # afmformats also logs the exceptions that it raises, with a traceback.
    logging.getLogger("afmformats").setLevel(logging.CRITICAL)
    refuse_large_archive(path, _MOST_OF_ONE_BYTES if path.lower().endswith(".jpk-force") else _MOST_UNPACKED_BYTES)
    override = {_NAMES[name]: value for name, value in constants.items() if is_raw(path)}

    def parts() -> Iterator[tuple[Any, float]]:
        for block, share in blocks_of(path, folder):
            try:
                yield afmformats.load_data(block, meta_override=override), share
            except MissingMetaDataError as error:
                names = [ours for ours, theirs in _NAMES.items() if theirs in error.meta_keys]
                raise ValueError(lacks(names)) from error
            except FileFormatNotSupportedError as error:
                # afmformats knows two kinds of JPK pauses; a file with another is of no format to it.
                if (count := _segments_of(path)) > 2:
                    raise ValueError(refusal_of_pause(f"{count} segments")) from error
                raise NoCurvesError(_NO_CURVES) from error
            # Such as a foreign archive, one line of a grid, or a text with other columns than a recipe expects.
            except (AFMFileFormatError, ArithmeticError, AttributeError, LookupError, ValueError) as error:
                raise NoCurvesError(_NO_CURVES) from error

    blocks = parts()
    first, share = next(blocks)
    if not len(first):
        raise ValueError("it has no curve")

    def each() -> Iterator[tuple[Callable[[], RecordedCurve], float]]:
        for curves, done in chain([(first, share)], blocks):
            for curve in curves:
                yield partial(_recorded, curve), done

    shape, sides = ([first[0].metadata.get(f"grid {key} {axis}", none) for axis in "xy"] for key, none in
                    (("shape", 1), ("size", 0.0)))  # fmt: skip
    return Curves((int(shape[0]), int(shape[1])), (float(sides[0]), float(sides[1])), each())


# File name endings that afmformats reads; those of raw deflections come first.
_RAW_SUFFIXES = (".jpk-", ".csv", ".txt", ".zip")
SUFFIXES = (*_RAW_SUFFIXES, ".h5", ".tab")


def is_raw(path: str) -> bool:
    """Return whether afmformats computes the forces of a file from constants that may replace those in the file."""
    return Path(path).suffix.lower().startswith(_RAW_SUFFIXES)


def _recorded(curve: Any) -> RecordedCurve:
    metadata = curve.metadata
    require_force_curve(metadata)
    height = np.asarray(curve["height (measured)" if "height (measured)" in curve else "height (piezo)"], np.float64)
    force, segment = np.asarray(curve["force"], np.float64), np.asarray(curve["segment"]).astype(int)
    if not len(force) or {len(height), len(segment)} != {len(force)}:
        raise ValueError(f"its columns have {len(force)}, {len(height)} and {len(segment)} points")
    if len(kinds := np.unique(segment)) > 2:
        raise ValueError(refusal_of_pause(f"{len(kinds)} segments"))
    if segment[0] == segment[-1]:
        raise ValueError("it needs an approach and a retraction")
    ways = tuple((height[part], force[part]) for part in (segment == segment[0], segment == segment[-1]))
    place = (int(metadata.get("grid index x", 0)), int(metadata.get("grid index y", 0)))
    stiffness, sensitivity = (float(metadata[key]) if key in metadata else None for key in _NAMES.values())
    return RecordedCurve(place, ways, "N", stiffness, sensitivity, float(metadata.get("speed approach", 1.0)))


def refuse_large_archive(path: str, most_bytes: int = _MOST_UNPACKED_BYTES) -> None:
    """Raise ValueError for an archive that unpacks to too much or has overlapping entries; ignore other files."""
    if not zipfile.is_zipfile(path):
        return
    with zipfile.ZipFile(path) as archive:
        entries = sorted(archive.infolist(), key=lambda each: each.header_offset)
    most_bytes = min(most_bytes, _ORDINARY_BYTES + _GREATEST_RATIO * Path(path).stat().st_size)
    if (unpacked := sum(each.file_size for each in entries)) > most_bytes:
        raise ValueError(f"it unpacks to {unpacked} bytes, at most {most_bytes} are read")
    for one, after in pairwise(entries):
        if one.header_offset + _LEAST_HEAD + one.compress_size > after.header_offset:
            raise ValueError(f"its entries {one.filename!r} and {after.filename!r} overlap")


def blocks_of(path: str, folder: Path) -> Iterator[tuple[str, float]]:
    """Yield archives that each hold a block of the curves of an archive, and the share that is done after it.

    afmformats looks at all names of an archive for each curve, so large archives would take quadratic time.
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
    # Images and settings of other programs are skipped.
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


def require_force_curve(metadata: Any) -> None:
    """Raise ValueError for a curve of another imaging mode, which is no force against distance."""
    mode = str(metadata.get("imaging mode", "")) or "force-distance"
    if mode != "force-distance":
        raise ValueError(refusal_of_pause(mode))


def refusal_of_pause(kind: str) -> str:
    """Return the reason why curves of a kind that hold the tip for a while cannot be used."""
    return (
        f"it holds curves of {kind.replace('-', ' ')}, taken over time at a constant force or place, and no force "
        "against distance: give a curve of an approach and a retraction without a pause"
    )


def _segments_of(path: str) -> int:
    """Return the number of segments of the longest curve in a JPK archive; 0 for another file."""
    if not zipfile.is_zipfile(path):
        return 0
    with zipfile.ZipFile(path) as archive:
        matches = [re.search(r"(?:^|/)segments/(\d{1,6})/", name) for name in archive.namelist()]
    return max((int(each[1]) + 1 for each in matches if each), default=0)


def tell(report: int, share: float) -> None:
    """Write the share that is done to the descriptor, as a byte of percent."""
    os.write(report, bytes([min(int(100.0 * share), 100)]))

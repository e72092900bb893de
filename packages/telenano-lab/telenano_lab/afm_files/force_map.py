"""Recorded maps as files: a channel on an even grid over (x, y, z), with everything needed to feel it.

A map is an uncompressed `.npz` of NumPy. It is read whole into memory, so that no step of the instrument waits for a
page fault. Its members:

| member | meaning |
|---|---|
| `value` | shape (x, y, z) or (x, y, z, 2), approach and then retract |
| `x`, `y`, `z` | the points of each axis; z rises away from the sample |
| `unit`, `length_unit` | unit of `value` (N, Hz, A, m, rad, and multiples) and of the axes |
| `sign` | 1: a repulsive force is positive; -1: it is negative; for forces |
| `axis` | `base`: z is the height of the base; `tip`: that of the tip, deflected by F / k; for forces |
| `stiffness_n_per_m` | spring constant of the cantilever that measured it; for forces |
| `sensitivity_m_per_v` | sensitivity, if the unit of `value` is a voltage |
| `source` | origin of the data, in words |
"""

import hashlib
import math
import os
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from telenano.extend.maps import SI_UNITS, UNITS, Array, MapFormat, OverMap, Span
from telenano.files import atomic_file, open_regular
from telenano.settings import FileReader
from telenano.wire import ConfigError
from telenano_lab.afm_files.recorded_map import MapParams, start, step

# Length units of the axes, in metres.
METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9, "pm": 1e-12, "Å": 1e-10}
MEMBERS = ("unit", "length_unit", "sign", "axis", "stiffness_n_per_m", "sensitivity_m_per_v", "source")
_KNOWN = frozenset({*MEMBERS, "x", "y", "z"})
MOST_VALUES = 1 << 27
# The largest array of a file that states a fact about the map.
_MOST_FACT_BYTES = 1 << 20
# Large arrays are read in pieces of this size.
_PIECE_BYTES = 1 << 24
_NPY_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
# Two branches count as one where they differ by less than this share of their greatest difference.
_CLOSED = 0.05
# A curve is in contact where its force exceeds this share of its range.
_CONTACT = 0.05
# The steps of an axis may differ by this share of its greatest value.
_EVEN = 1e-6


class ForceMap(NamedTuple):
    """A map in SI units.

    values: shape (branches, x, y, z), a repulsive force positive; x_m, y_m, z_m: even axes [m]; quantity: force or a
    name of UNITS; stiffness_n_per_m: of the cantilever [N/m], 0 where the values are not forces; source: origin in
    words.
    """

    values: Array
    x_m: Array
    y_m: Array
    z_m: Array
    quantity: str
    stiffness_n_per_m: float
    source: str


class MapError(ValueError):
    """A map that cannot be used; the message names the member and the fault."""


def checked_map(header: dict[str, Any], values: npt.NDArray[Any]) -> ForceMap:
    """Return the map in SI units that the members describe; MapError names a faulty member and what would be right.

    Args:
        header: All members except `value`, as plain values and arrays.
        values: The member `value`.
    """
    if values.ndim not in (3, 4) or (values.ndim == 4 and values.shape[3] not in (1, 2)) or 0 in values.shape:
        raise MapError(f"value: has the shape {values.shape}; it must be (x, y, z), or (x, y, z, 2) with both branches")
    if values.dtype.kind not in "fiu":
        raise MapError(f"value: is of type {values.dtype}; it must be numbers")
    if values.size > MOST_VALUES:
        raise MapError(f"value: has {values.size} values, at most {MOST_VALUES} are read: thin it out first")
    scale = METRES[_known(header, "length_unit", METRES)]
    x, y, z = (_axis(header, name, values.shape[i], scale) for i, name in enumerate("xyz"))
    quantity, factor = UNITS[_known(header, "unit", UNITS)]
    stiffness = 0.0
    if quantity == "voltage":
        factor *= _positive(header, "sensitivity_m_per_v") * _positive(header, "stiffness_n_per_m")
        quantity = "force"
    if quantity == "force":
        stiffness = _positive(header, "stiffness_n_per_m")
        factor *= float(_known(header, "sign", (1, -1)))
    bad = int(values.size - np.count_nonzero(np.isfinite(values)))
    if bad:
        raise MapError(f"value: {bad} of {values.size} values are not finite; interpolate them first")
    branches = values[..., None] if values.ndim == 3 else values
    ordered = np.array(np.moveaxis(branches, 3, 0), dtype=np.float64, order="C")
    ordered *= factor
    if quantity == "force" and _known(header, "axis", ("base", "tip")) == "tip":
        ordered, z = _over_base(ordered, z, stiffness)
    return ForceMap(ordered, x, y, z, quantity, stiffness, str(header.get("source", "")))


def _axis(header: dict[str, Any], name: str, points: int, scale: float) -> Array:
    if name not in header:
        raise MapError(f"{name}: is missing; it must be the {points} points of that axis")
    axis = np.asarray(header[name])
    if axis.dtype.kind not in "fiu" or axis.shape != (points,) or not np.isfinite(axis).all():
        got = f"{axis.dtype} of shape {axis.shape}"
        raise MapError(f"{name}: must be {points} finite numbers, as value has points along it, not {got}")
    axis = axis.astype(np.float64) * scale
    steps = np.diff(axis)
    if points > 1 and not (steps > 0.0).all():
        at = int(np.argmin(steps))
        raise MapError(f"{name}: must rise from point to point; after point {at} it goes by {steps[at]:.3g} m")
    if points > 1 and not np.abs(steps - steps.mean()).max() <= _EVEN * abs(axis).max() + 1e-3 * steps.mean():
        raise MapError(f"{name}: its points must be even; they are {steps.min():.4g} to {steps.max():.4g} m apart")
    if points < 4 and name == "z":
        raise MapError(f"z: has {points} points; a curve has 4 or more")
    if not axis[-1] - axis[0] <= 1e-3:
        raise MapError(f"{name}: spans {axis[-1] - axis[0]:g} m, more than 1 mm: is length_unit right?")
    return axis


def _known(header: dict[str, Any], name: str, allowed: Any) -> Any:
    value = header.get(name)
    value = int(value) if isinstance(value, float) and value.is_integer() else value
    if value is None or value not in allowed:
        fault = f"is missing (--set {name}=…)" if value is None else f"is {value!r}"
        shown = ", ".join(str(each) for each in allowed) if len(allowed) < 12 else "N, nN, pN, Hz, A, m, rad, deg, V"
        raise MapError(f"{name}: {fault}; it must be one of {shown}")
    return value


def _positive(header: dict[str, Any], name: str) -> float:
    value = header.get(name)
    if value is None:
        raise MapError(f"{name}: is missing; give it to `telenano sample import` by --set {name}=…")
    if not (isinstance(value, int | float) and 0.0 < value < math.inf):
        raise MapError(f"{name}: is {value!r}; it must be a number above 0")
    return float(value)


def _over_base(values: Array, z: Array, stiffness: float) -> tuple[Array, Array]:
    """Convert curves over the height of the tip into curves over that of the base, z - F / k, on a common axis."""
    base = z - values / stiffness
    if not (np.diff(base, axis=3) > 0.0).all():
        branch, i, j, _ = np.unravel_index(int(np.argmin(np.diff(base, axis=3))), np.diff(base, axis=3).shape)
        raise MapError(
            f"axis: tip: with stiffness_n_per_m = {stiffness:g} N/m the base would go back in the curve {i}, {j} of"
            f" branch {branch}: a force that changes by more than k in a metre is passed in a jump"
        )
    low, high = float(base[..., 0].max()), float(base[..., -1].min())
    if not low < high:
        raise MapError("axis: tip: the curves have no height of the base in common")
    common = np.linspace(low, high, len(z))
    flat = [np.interp(common, *pair) for pair in zip(base.reshape(-1, len(z)), values.reshape(-1, len(z)), strict=True)]
    return np.array(flat).reshape(values.shape), common


def gates(recorded: ForceMap) -> tuple[Array, Array]:
    """Return the heights at which contact is made and at which the loop of the branches closes [m], shape (x, y).

    Contact is made at the lowest force of the approach, after the snap-in; without attraction, where the force has
    risen by a twentieth of its range. The loop is closed above the last point at which the branches differ by more than
    a twentieth of their greatest difference. Differences within the noise far from the sample are ignored.
    """
    if recorded.quantity != "force":
        shape = recorded.values.shape[1:3]
        return np.full(shape, math.inf), np.full(shape, math.inf)
    # The map is processed column by column, so that the curves stay in the processor's cache.
    columns = [_gates(recorded.values[:, i], recorded.z_m) for i in range(len(recorded.x_m))]
    return np.array([onset for onset, _ in columns]), np.array([release for _, release in columns])


def _gates(values: Array, z: Array) -> tuple[Array, Array]:
    down, far = values[0] - values[0][:, -1:], slice(-max(len(z) // 10, 2), None)
    # Differences within the noise far from the sample are ignored.
    rises = np.maximum(_CONTACT * np.ptp(down, axis=1), np.ptp(down[:, far], axis=1))
    risen = down > rises[:, None]
    last = np.where(risen.any(axis=1), len(z) - 1 - np.argmax(risen[:, ::-1], axis=1), 0)
    onset = np.where(down.min(axis=1) < -rises, z[np.argmin(down, axis=1)], z[last])
    if len(values) == 1:
        return onset, onset
    apart = np.abs(values[0] - values[1])
    wide = apart > np.maximum(_CLOSED * apart.max(axis=1), apart[:, far].max(axis=1))[:, None]
    over = np.minimum(len(z) - np.argmax(wide[:, ::-1], axis=1), len(z) - 1)
    return onset, np.maximum(np.where(wide.any(axis=1), z[over], onset), onset)


def map_params(recorded: ForceMap, rest_distance_m: float, stiffness_n_per_m: float, volts_per_m: float) -> MapParams:
    """Return the parameters with which the instrument steps over a map; the middle of the map is x = y = 0.

    Args:
        recorded: The map.
        rest_distance_m: Height on the map of the base that the instrument has at 0 [m].
        stiffness_n_per_m: Spring constant of the cantilever [N/m], used if the map has none.
        volts_per_m: The gain of the read-out [V/m].
    """
    onset, release = gates(recorded)
    steps = [float(axis[-1] - axis[0]) / max(len(axis) - 1, 1) for axis in (recorded.x_m, recorded.y_m, recorded.z_m)]
    low = (-0.5 * steps[0] * (len(recorded.x_m) - 1), -0.5 * steps[1] * (len(recorded.y_m) - 1), float(recorded.z_m[0]))
    sizes = (steps[0] or 1.0, steps[1] or 1.0, steps[2])
    return MapParams(
        recorded.values, low, sizes, onset, release, 2.0 * steps[2], rest_distance_m,
        recorded.stiffness_n_per_m or stiffness_n_per_m, volts_per_m, recorded.quantity == "force",
    )  # fmt: skip


def write_map(path: Path, recorded: ForceMap) -> None:
    """Write a map to its file; raise OSError if it cannot be written."""
    members: dict[str, Any] = {
        "unit": SI_UNITS[recorded.quantity], "length_unit": "m", "source": recorded.source,
        "value": np.moveaxis(recorded.values, 0, 3), "x": recorded.x_m, "y": recorded.y_m, "z": recorded.z_m,
    }  # fmt: skip
    if recorded.quantity == "force":
        members |= {"sign": 1, "axis": "base", "stiffness_n_per_m": recorded.stiffness_n_per_m}
    with atomic_file(path) as part, part.open("wb") as file:
        np.savez(file, **members)


def read_members(path: Path, *, values: bool = True) -> tuple[dict[str, Any], npt.NDArray[Any] | None]:
    """Return the members of a `.npz` as plain values and arrays, and `value`, None unless values is True.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is not a complete `.npz`. Sizes in headers are checked before memory is allocated.
    """
    members: dict[str, Any] = {}
    grid = None
    with open_regular(path) as file:
        try:
            with zipfile.ZipFile(file) as archive:
                for member in archive.infolist():
                    name = member.filename.removesuffix(".npy")
                    if name in _KNOWN:
                        members[name] = _plain(_member(archive, member, _MOST_FACT_BYTES))
                    elif values and name == "value":
                        grid = _member(archive, member, 8 * MOST_VALUES)
        except (MapError, OSError):
            raise
        # Damaged files make zipfile and zlib raise exceptions of any kind.
        except Exception as error:
            raise MapError(f"is not a complete .npz file: {error}") from error
    if values and grid is None:
        raise MapError("value: is missing; it must be the grid over (x, y, z)")
    return members, grid


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, most_bytes: int) -> npt.NDArray[Any]:
    name = member.filename.removesuffix(".npy")
    if member.file_size > most_bytes:
        raise MapError(f"{name}: has {member.file_size} bytes, at most {most_bytes} are read")
    with archive.open(member) as file:
        version = npy.read_magic(file)
        if version not in _NPY_HEADERS:
            raise MapError(f"{name}: is of version {version[0]}.{version[1]} of .npy, which is not read")
        shape, fortran, kind = _NPY_HEADERS[version](file)
        stated, there = math.prod(shape) * kind.itemsize, member.file_size - file.tell()
        if kind.hasobject or min(shape, default=0) < 0 or stated != there:
            raise MapError(f"{name}: has {there} bytes; {kind} of shape {shape} is {stated}")
        # No memory is allocated for a stated size before the bytes are there.
        content = bytearray()
        while len(content) < stated and (part := file.read(min(stated - len(content), _PIECE_BYTES))):
            content += part
    if len(content) != stated:
        raise MapError(f"{name}: ends after {len(content)} of {stated} bytes")
    return np.frombuffer(content, kind).reshape(shape, order="F" if fortran else "C")


def _plain(value: npt.NDArray[Any]) -> Any:
    return value.item() if value.ndim == 0 else value


def read_map(path: Path) -> tuple[ForceMap, str]:
    """Return a map that can be felt, and the digest of its file (16 hex digits of SHA-256).

    Raises:
        ConfigError: The file cannot be used; the message names it, the member and what would be right.
    """
    try:
        members, values = read_members(path)
        assert values is not None
        whole = checked_map(members, values)
        digest = hashlib.sha256()
        with open_regular(path) as file:
            while part := file.read(_PIECE_BYTES):
                digest.update(part)
        return whole, digest.hexdigest()[:16]
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from error


def span_of(path: Path) -> Span | None:
    """Return the extent, stiffness and quantity of a map; None if the file is unreadable or no map over the base."""
    try:
        stated = path.stat()
        return _span(os.fspath(path), stated.st_mtime_ns, stated.st_size)
    except (OSError, ValueError, KeyError):
        return None


@lru_cache(maxsize=16)
def _span(path: str, changed_ns: int, size: int) -> Span | None:
    members, _ = read_members(Path(path), values=False)
    if members.get("axis", "base") != "base":
        whole, _ = read_map(Path(path))
        x, y, z, quantity, stiffness = whole.x_m, whole.y_m, whole.z_m, whole.quantity, whole.stiffness_n_per_m
    else:
        scale = METRES[members["length_unit"]]
        x, y, z = (np.asarray(members[name], dtype=np.float64) * scale for name in "xyz")
        quantity = UNITS[members["unit"]][0].replace("voltage", "force")
        stiffness = float(members["stiffness_n_per_m"]) if quantity == "force" else 0.0
    return Span(float(z[0]), float(z[-1]), 0.5 * float(x[-1] - x[0]), 0.5 * float(y[-1] - y[0]), stiffness, quantity)


def read_over_map(path: Path, rest_distance_m: float, stiffness_n_per_m: float, volts_per_m: float) -> OverMap:
    """Return a map file as the surface that an instrument steps over; ConfigError names the file and its fault."""
    force_map, digest = read_map(path)
    params = map_params(force_map, rest_distance_m, stiffness_n_per_m, volts_per_m)
    points, branches = " x ".join(map(str, force_map.values.shape[1:])), ("one branch", "approach and retract")
    about = (
        f"{path.name} ({digest}): {force_map.quantity} [{SI_UNITS[force_map.quantity]}], {points} points,"
        f" {branches[len(force_map.values) - 1]}"
    )
    return OverMap(params, params.stiffness_n_per_m, "" if params.is_force else force_map.quantity, about)


NPZ = FileReader(map=MapFormat(MapParams, start, step, span_of, read_over_map))

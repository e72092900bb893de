"""Import recorded maps from the files of instruments onto one grid.

| file | content | read by |
|---|---|---|
| `.npz`, `.h5` with a dataset `value` | a plain grid with the members of a map | numpy, h5py |
| those of `curve_files`, and a folder of `.ibw` of a map | curves | `curve_files` |
| `.3ds`, `.dat` | a grid or a spectroscopy of Nanonis whose sweep is z | this module |

Each curve has its own heights; all are cut to the range that they share. With `level: each` the height of a curve
counts from its own lowest point, so that no curve loses its contact, and the topography is dropped; with `common` the
heights of the piezo are kept. In both cases the lowest point of the map is z = 0.
"""

import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.extend.maps import SI_UNITS, UNITS, Array
from telenano.files import open_regular, read_in_child
from telenano.wire import ConfigError
from telenano_lab.afm_files.bruker import is_nanoscope
from telenano_lab.afm_files.force_map import ForceMap, MapError, checked_map, read_members
from telenano_lab.afm_files.nanonis import backward_of, is_spectroscopy, sweep_of, unit_of
from telenano_lab.afm_files.readers import limits_of_curves
from telenano_lab.afm_files.sader_jarvis import ASKED, as_force
from telenano_lab.afm_files.text_curves import SUFFIXES, TableOptions

_LONGEST_3DS_HEADER = 1 << 18
# Greatest number of points along a side of a map's grid.
_MOST_SIDE = 4096
# A curve needs this number of valid points.
_LEAST_POINTS = 8
_CURVE_SUFFIXES = (
    ".jpk-force", ".jpk-force-map", ".jpk-qi-data", ".jpk-qi-series", ".ibw", ".nid", ".nhf", ".zip", ".csv", ".txt",
    ".h5", ".tab", ".asc", ".tsv",
)  # fmt: skip
MAP_SUFFIXES = (".npz", ".3ds", ".dat", *_CURVE_SUFFIXES)
# Share of the heights, farthest from the sample, over which the mean or the slope counts as that of free air.
_BASELINE = {"offset": 0.1, "tilt": 0.25}
# A free-air level above this share of the span of the mean force is more than noise.
_FREE_SHARE = 0.05
Watch = Callable[[float], None]


class MapOptions(NamedTuple):
    """The user's options: members of a map that its file lacks, and how its curves are brought onto one grid.

    given: members of a map; channel: part of the name of a channel, for .3ds; level: `each` or `common`; points: number
    of heights, 0 for that of the curves; correct: signal in free air that is subtracted: `offset` (the mean of each
    curve there; the default for curves), `tilt` (that, and a slope common to all curves), or `nothing` (the default for
    a plain grid); baseline: share of the heights that is free air, farthest from the sample, None for 0.1, or 0.25 with
    tilt; converted: whether a frequency shift is converted to a force (`sader_jarvis`).
    """

    given: Mapping[str, Any]
    channel: str | None = None
    level: str = "each"
    points: int = 0
    correct: str | None = None
    baseline: float | None = None
    converted: bool = False

    @property
    def free_share(self) -> float:
        """The share of the heights that is free air."""
        return _BASELINE["tilt" if self.correct == "tilt" else "offset"] if self.baseline is None else self.baseline


class ImportedMap(NamedTuple):
    """A map, and remarks on its import, in words."""

    map: ForceMap
    notes: tuple[str, ...]


Way = tuple[Array, Array]


class _Curves(NamedTuple):
    """Curves of a grid: [x][y][branch] a pair of rising heights [m] and values in their unit; sides of the grid [m]."""

    ways: list[list[list[Way]]]
    sides_m: tuple[float, float]
    facts: dict[str, Any]
    notes: tuple[str, ...] = ()


@contextmanager
def _faults_named(path: Path) -> Iterator[None]:
    """Convert errors in reading a file into a ConfigError that names the file."""
    try:
        yield
    except ImportError as error:
        text = f"{path}: needs {error.name} to be read: install telenano-lab with its dependencies"
        raise ConfigError(text) from error
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, KeyError) as error:
        raise ConfigError(f"{path}: {error}") from error


def _demand_content(path: Path) -> None:
    """Raise OSError if a file cannot be opened, and MapError if it is empty."""
    if not path.is_dir():
        open_regular(path).close()
        if path.stat().st_size == 0:
            raise MapError("is empty")


def _given_of(path: Path, wanted: MapOptions) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split the user's settings into members of a map and options of a text table; MapError if the file is no table."""
    members = {name: value for name, value in wanted.given.items() if name not in TableOptions._fields}
    options = {name: value for name, value in wanted.given.items() if name in TableOptions._fields}
    if options and path.suffix.lower() not in SUFFIXES:
        raise MapError(f"--set {next(iter(options))}: is for a text table; this file states it itself")
    return members, options


def import_map(path: Path, wanted: MapOptions, watch: Watch = lambda share: None) -> ImportedMap:
    """Return the map in a file.

    Args:
        path: The file.
        wanted: The user's options.
        watch: Called with the share that is read, from 0 to 1.

    Raises:
        ConfigError: The file cannot be used; the message names it, the key and what would be right.
    """
    with _faults_named(path):
        _demand_content(path)
        members, options = _given_of(path, wanted)
        members = {name: value for name, value in members.items() if name not in ASKED}
        imported = _import(path, wanted._replace(given=members), json.dumps(options), watch)
        imported = _corrected(imported, wanted)
        imported = imported._replace(notes=(*_in_free_air(imported.map), *imported.notes))
        if not wanted.converted:
            return imported
        text = (
            "the force is computed from the frequency shift, whose mean in the farthest tenth of a curve is taken as 0"
        )
        return ImportedMap(as_force(imported.map, dict(wanted.given)), (*imported.notes, text))


class Curves(NamedTuple):
    """Curves as they were taken: index in the file, place [m], and branches of height [m] and force [N] of each.

    The height is that of the base, ascending away from the sample; a repulsive force is positive; the approach comes
    first. is_grid: whether the places are those of a map.
    """

    numbers: list[int]
    places_m: list[tuple[float, float]]
    branches: list[list[Way]]
    stiffness_n_per_m: float
    is_grid: bool
    notes: tuple[str, ...]


def read_curves(path: Path, wanted: MapOptions, watch: Watch = lambda share: None) -> Curves:
    """Return the curves of a file, each over its own heights; those of a map file over its grid.

    Args:
        path: The file, or the folder of a map of waves.
        wanted: The user's options.
        watch: Called with the share that is read, from 0 to 1.

    Raises:
        ConfigError: The file cannot be used; the message names it, the key and what would be right.
    """
    suffix = path.suffix.lower()
    is_spectrum = suffix == ".dat" and not path.is_dir() and is_spectroscopy(str(path))
    is_grid_h5 = suffix == ".h5" and not path.is_dir() and _is_plain_grid(path)
    if suffix in (".npz", ".3ds") or is_spectrum or is_grid_h5:
        imported = import_map(path, wanted._replace(level="common", correct="nothing"), watch)
        return _curves_of_map(path, imported)
    with _faults_named(path):
        _demand_content(path)
        if suffix not in (".dat", *_CURVE_SUFFIXES) and not path.is_dir() and not _is_bruker(path):
            raise MapError(f"is not a file of force curves that can be read; these are {', '.join(MAP_SUFFIXES)}")
        members, options = _given_of(path, wanted)
        facts, (places, counts, heights, forces) = _load(
            path, wanted._replace(given=members), json.dumps(options), watch
        )
        given = members.get("stiffness_n_per_m", facts["stiffness_n_per_m"])
        stiffness = _positive_stiffness(given)
    ends = np.cumsum(counts.ravel()).reshape(-1, 2).tolist()
    branches = [
        [(heights[cut], forces[cut]) for cut in (slice(end - sizes[0], end), slice(end, stop))]
        for sizes, (end, stop) in zip(counts.tolist(), ends, strict=True)
    ]
    pitch = [side / max(count, 1) for side, count in zip(facts["sides"], facts["shape"], strict=True)]
    at = [((i + 0.5) * pitch[0], (j + 0.5) * pitch[1]) for i, j in places.tolist()]
    is_grid = len({tuple(place) for place in places.tolist()}) == len(places) > 1
    return Curves(list(range(len(branches))), at, branches, stiffness, is_grid, ())


def _positive_stiffness(value: Any) -> float:
    if value is None:
        raise MapError("stiffness_n_per_m: the file has no such value; give --set stiffness_n_per_m=…")
    if not (isinstance(value, int | float) and 0.0 < value < math.inf):
        raise MapError(f"stiffness_n_per_m: is {value!r}; it must be a number above 0")
    return float(value)


def _is_plain_grid(path: Path) -> bool:
    try:
        read_in_child("telenano_lab.afm_files.map_libraries:load_grid", path)
    except (ValueError, OSError, ImportError):
        # The reader of curves will report the fault.
        return False
    return True


def _curves_of_map(path: Path, imported: ImportedMap) -> Curves:
    whole = imported.map
    if whole.quantity != "force":
        raise ConfigError(f"{path}: is a map of {whole.quantity.replace('_', ' ')}, and no force can be fitted to it")
    nx, ny = len(whole.x_m), len(whole.y_m)
    places = [(i, j) for i in range(nx) for j in range(ny)]
    branches = [[(whole.z_m, branch[i, j]) for branch in whole.values] for i, j in places]
    at = [(float(whole.x_m[i]), float(whole.y_m[j])) for i, j in places]
    return Curves(list(range(nx * ny)), at, branches, whole.stiffness_n_per_m, nx * ny > 1, imported.notes)


def _import(path: Path, wanted: MapOptions, options: str, watch: Watch) -> ImportedMap:
    suffix = path.suffix.lower()
    source = {"source": path.name}
    has_channels = suffix == ".3ds" or (suffix == ".dat" and is_spectroscopy(str(path)))
    if wanted.channel is not None and not has_channels:
        raise MapError(
            f"channel {wanted.channel!r}: this file has one quantity, and no channels to choose from: leave it out"
        )
    if suffix == ".npz":
        members, values = read_members(path)
        assert values is not None
        return ImportedMap(checked_map({**source, **members, **wanted.given}, values), ())
    if has_channels:
        read = _read_3ds if suffix == ".3ds" else _read_dat
        return _on_one_grid(read(path, wanted.channel), wanted, source)
    if suffix not in (".dat", *_CURVE_SUFFIXES) and not path.is_dir() and not _is_bruker(path):
        raise MapError(f"is no recorded map that can be read; these are {', '.join(MAP_SUFFIXES)}")
    if suffix == ".h5":
        try:
            facts, (values, *axes) = read_in_child("telenano_lab.afm_files.map_libraries:load_grid", path)
        except ValueError as error:
            # A file of afmformats has numbered groups of columns instead.
            if not str(error).startswith("value: is missing"):
                raise
        else:
            return ImportedMap(
                checked_map({**source, **facts, **dict(zip("xyz", axes, strict=True)), **wanted.given}, values), ()
            )
    return _on_one_grid(_read_curves(path, wanted, options, watch), wanted, source)


def _in_free_air(recorded: ForceMap) -> list[str]:
    """Return remarks on the force of a map far from its sample, where it should be zero, and at the sample."""
    if recorded.quantity != "force" or recorded.values.shape[-1] < 2 * _LEAST_POINTS:
        return []
    curves = recorded.values.reshape(-1, recorded.values.shape[-1])
    middle = np.array([math.fsum(row) / len(row) for row in curves.T.tolist()])
    far = middle[-max(len(middle) // 4, 2) :]
    span, level = float(np.ptp(middle)), math.fsum(far.tolist()) / len(far)
    step_m = float(recorded.z_m[1] - recorded.z_m[0])
    tilt = (float(far[-1]) - float(far[0])) / (step_m * (len(far) - 1))
    notes = []
    if abs(level) > _FREE_SHARE * span:
        notes.append(
            f"at its top, in free air, its force is {1e9 * level:.3g} nN, which a hand would feel: --correct offset"
            " removes it"
        )
    if abs(tilt) * step_m * len(middle) > 2.0 * _FREE_SHARE * span:
        notes.append(
            f"at its top, in free air, its force rises by {tilt:.3g} N/m: its base line is tilted, and --correct"
            " tilt removes that"
        )
    if float(middle[0]) < level - _FREE_SHARE * span and int(np.argmax(np.abs(middle - level))) == 0:
        notes.append("its greatest force is at its bottom and pulls: is its sign turned? Then give --set sign=-1")
    return notes


def _corrected(imported: ImportedMap, wanted: MapOptions) -> ImportedMap:
    """Subtract the free-air level, and with `tilt` the free-air slope, from a map if the user asked for it."""
    if wanted.correct not in _BASELINE:
        return imported
    whole = imported.map
    if whole.quantity not in ("force", "voltage"):
        raise MapError(f"--correct {wanted.correct}: is for a force or a deflection, not for a {whole.quantity}")
    count = max(int(wanted.free_share * len(whole.z_m)), 2)
    unit = SI_UNITS[whole.quantity]
    heights = whole.z_m - math.fsum(whole.z_m[-count:].tolist()) / count
    # Only the approaches count: a retraction may still pull there.
    far = [whole.values[0][..., place] for place in range(-count, 0)]
    values, notes = whole.values, []
    if wanted.correct == "tilt":
        middle = [math.fsum(one.ravel().tolist()) / one.size for one in far]
        near = heights[-count:].tolist()
        slope = math.fsum(z * value for z, value in zip(near, middle, strict=True)) / math.fsum(z * z for z in near)
        values = values - slope * heights
        notes.append(f"a slope of {slope:.3g} {unit}/m, that of its curves in free air, is taken off")
    levels = np.sum(far, axis=0) / count
    values = values - levels[None, ..., None]
    low, high = float(levels.min()), float(levels.max())
    notes.append(f"the mean of each curve in free air, {low:.3g} to {high:.3g} {unit}, is taken off")
    return ImportedMap(whole._replace(values=values), (*imported.notes, *notes))


def _load(path: Path, wanted: MapOptions, options: str, watch: Watch) -> tuple[dict[str, Any], list[Array]]:
    """Return the result of `curve_files.load_curves` in a child process."""
    constants = [wanted.given.get(name) for name in ("stiffness_n_per_m", "sensitivity_m_per_v")]
    texts = [None if value is None else repr(float(value)) for value in constants]
    limits = limits_of_curves(sum(file.stat().st_size for file in ([path] if path.is_file() else path.iterdir())))
    return read_in_child(
        "telenano_lab.afm_files.curve_files:load_curves", path, *texts, options, limits=limits, watch=watch
    )


def _read_curves(path: Path, wanted: MapOptions, options: str, watch: Watch) -> _Curves:
    facts, (places, counts, heights, forces) = _load(path, wanted, options, watch)
    # A part of a grid, or a stopped grid, is a map if its places are even and each has a curve.
    lines = [np.unique(places[:, axis]) for axis in (0, 1)]
    nx, ny = (len(line) for line in lines)
    is_even = all(len(set(np.diff(line).tolist())) < 2 for line in lines)
    if not is_even or len(places) != nx * ny or len({tuple(place) for place in places.tolist()}) != nx * ny:
        raise MapError(f"has {len(places)} curves at {nx} columns and {ny} lines of its grid: a map needs one for each")
    ends = np.cumsum(counts.ravel()).reshape(-1, 2).tolist()
    ways: list[list[list[Way]]] = [[[] for _ in range(ny)] for _ in range(nx)]
    for place, sizes, (end, stop) in zip(places.tolist(), counts.tolist(), ends, strict=True):
        i, j = (int(np.searchsorted(line, at)) for line, at in zip(lines, place, strict=True))
        cuts = (slice(end - sizes[0], end), slice(end, stop))
        ways[i][j] = [(heights[cut], forces[cut]) for cut in cuts]
    whole = facts["shape"]
    notes = () if [nx, ny] == whole else (f"{nx} x {ny} of {whole[0]} x {whole[1]} places have a curve",)
    pitch = [side / max(count, 1) for side, count in zip(facts["sides"], whole, strict=True)]
    strides = [int(line[1] - line[0]) if len(line) > 1 else 1 for line in lines]
    sides = (pitch[0] * strides[0] * nx, pitch[1] * strides[1] * ny)
    # A repulsive force is positive, and the height is that of the piezo.
    stated = {"unit": "N", "sign": 1, "axis": "base", "stiffness_n_per_m": facts["stiffness_n_per_m"]}
    return _Curves(ways, sides, stated, notes)


def _read_3ds(path: Path, channel: str | None) -> _Curves:
    with open_regular(path) as file:
        head = file.read(_LONGEST_3DS_HEADER)
        mark = re.search(rb":HEADER_END:\r?\n", head)
        if mark is None:
            raise MapError("is not a complete .3ds file: it has no :HEADER_END: line")
        header = dict(
            (key.strip(), value.strip().strip('"'))
            for key, sign, value in (
                line.partition("=") for line in head[: mark.start()].decode("utf-8", "replace").splitlines()
            )
            if sign
        )
        file.seek(mark.end())
        content = file.read()
    grid = re.fullmatch(r"(\d{1,4}) x (\d{1,4})", header.get("Grid dim", ""))
    if grid is None:
        raise MapError(f"Grid dim: is {header.get('Grid dim', 'missing')!r}; it must be as 64 x 64")
    nx, ny = (int(side) for side in grid.groups())
    names, fixed = (
        _listed(header, "Channels"),
        _listed(header, "Fixed parameters") + _listed(header, "Experiment parameters"),
    )
    points, parameters = _whole(header, "Points"), _whole(header, "# Parameters (4 byte)")
    if not header.get("Sweep Signal", "").startswith("Z"):
        raise MapError(f"Sweep Signal: is {header.get('Sweep Signal', 'missing')!r}; a map needs a sweep of Z (m)")
    record = 4 * (parameters + len(names) * points)
    whole, rest = divmod(len(content), record)
    lines = min(whole // nx, ny) if nx else 0
    if rest or lines < 1 or whole > nx * ny:
        raise MapError(
            f"is not a complete .3ds file: it has {len(content)} bytes of curves, and {nx} x {ny} of {record} bytes are"
            f" {nx * ny * record}"
        )
    data = np.frombuffer(content, ">f4", lines * nx * record // 4).reshape(lines, nx, -1).astype(np.float64)
    curves = data[:, :, parameters:].reshape(lines, nx, len(names), points)
    chosen = _chosen(names, channel)
    unit = unit_of(names[chosen])
    back = _backward(names, chosen)
    heights = _sweep(data, curves, names, fixed, points)
    if back is not None and float(np.nansum(np.diff(heights, axis=2))) > 0.0:
        # The sweep goes away from the sample, so the backward channel is the approach.
        chosen, back = back, chosen
    branches = [chosen] if back is None else [chosen, back]
    ways = [[[_way(heights[j, i], curves[j, i, b]) for b in branches] for j in range(lines)] for i in range(nx)]
    width, depth = _sides(header)
    notes = [] if lines == ny else [f"the grid was stopped: {lines} of {ny} lines are whole and are taken"]
    if lost := int(np.count_nonzero(~np.isfinite(curves[:, :, branches]))):
        notes.append(f"{lost} values are no number, where curves were cut short; the others are taken")
    facts = {"unit": unit, "axis": "base"}
    return _Curves(ways, (width, depth * lines / ny), facts, tuple(notes))


def _is_bruker(path: Path) -> bool:
    with open_regular(path) as file:
        return is_nanoscope(file.read(64))


def _read_dat(path: Path, channel: str | None) -> _Curves:
    facts, (table,) = read_in_child("telenano_lab.afm_files.nanonis:load_table", path)
    height, columns = sweep_of(facts, table)
    names = list(columns)
    chosen = _chosen(names, channel)
    back = _backward(names, chosen)
    branches = [chosen] if back is None else [chosen, back]
    if back is not None and height[-1] > height[0]:
        branches = branches[::-1]
    ways = [_way(height, columns[names[place]]) for place in branches]
    lost = sum(len(height) - len(z) for z, _ in ways)
    notes = (f"{lost} values are no number, where curves were cut short; the others are taken",) if lost else ()
    return _Curves([[ways]], (0.0, 0.0), {"unit": unit_of(names[chosen]), "axis": "base"}, notes)


def _way(height: Array, value: Array) -> Way:
    sound = np.isfinite(height) & np.isfinite(value)
    order = np.argsort(height[sound], kind="stable")
    return height[sound][order], value[sound][order]


def _listed(header: Mapping[str, str], key: str) -> list[str]:
    if not header.get(key):
        raise MapError(f"{key}: is missing in its header")
    return [name.strip() for name in header[key].split(";")]


def _whole(header: Mapping[str, str], key: str) -> int:
    if not re.fullmatch(r"\d{1,6}", header.get(key, "")):
        raise MapError(f"{key}: is {header.get(key, 'missing')!r}; it must be a whole number")
    return int(header[key])


def _sides(header: Mapping[str, str]) -> tuple[float, float]:
    try:
        width, depth = (float(part) for part in header["Grid settings"].split(";")[2:4])
    except (KeyError, ValueError):
        raise MapError(
            f"Grid settings: is {header.get('Grid settings', 'missing')!r}; it must be as x;y;w;h;angle"
        ) from None
    return width, depth


def _chosen(names: list[str], wanted: str | None) -> int:
    """Return the index of the forward channel whose name contains `wanted`; by default a force or frequency shift."""
    forward = [i for i, name in enumerate(names) if "[bwd]" not in name]
    if wanted is None:
        channels = [i for i in forward if unit_of(names[i]) in ("N", "Hz")]
    else:
        channels = [i for i in forward if wanted.lower() in names[i].lower()]
    if not channels:
        text = "has no force and no frequency shift" if wanted is None else f"has no channel {wanted!r}"
        raise MapError(f"Channels: {text}; choose one of {', '.join(names[i] for i in forward)}")
    return channels[0]


def _backward(names: list[str], chosen: int) -> int | None:
    other = backward_of(names[chosen])
    return names.index(other) if other in names else None


def _sweep(data: Array, curves: Array, names: list[str], fixed: list[str], points: int) -> Array:
    """Return the measured heights of all points [m], shape (lines, columns, points), else those of the sweep."""
    if "Z (m)" in names:
        return curves[:, :, names.index("Z (m)")]
    start, stop = (data[:, :, fixed.index(name)] for name in ("Sweep Start", "Sweep End"))
    offset = data[:, :, fixed.index("Z (m)")] if "Z (m)" in fixed else 0.0
    shares = np.linspace(0.0, 1.0, points)
    swept: Array = (start + offset)[..., None] + shares * (stop - start)[..., None]
    return swept


def _on_one_grid(curves: _Curves, wanted: MapOptions, source: dict[str, Any]) -> ImportedMap:
    facts = {**source, **{key: value for key, value in curves.facts.items() if value is not None}, **wanted.given}
    flat = [way for column in curves.ways for curve in column for way in curve]
    for place, (z, _) in enumerate(flat):
        if len(z) < _LEAST_POINTS:
            raise MapError(f"value: way {place} of {len(flat)} has {len(z)} valid points; it needs {_LEAST_POINTS}")
        if not z[-1] > z[0]:
            raise MapError(
                f"z: way {place} of {len(flat)} stays at one height; a curve goes towards the sample or away"
            )
    if max(len(curves.ways), len(curves.ways[0])) > _MOST_SIDE:
        raise MapError(
            f"value: its grid is of {len(curves.ways)} x {len(curves.ways[0])}; a side has up to {_MOST_SIDE}"
        )
    quantity = UNITS.get(facts.get("unit", ""), ("", 0.0))[0]
    zeros = [min(way[0][0] for way in curve) if wanted.level == "each" else 0.0 for curve in _each(curves.ways)]
    low, high = _common(zip(_each(curves.ways), zeros, strict=True))
    if not low < high:
        raise MapError(
            "z: its curves have no heights in common: with --level each each counts from its own lowest point"
        )
    points = wanted.points or min(max(int(np.median([len(z) for z, _ in flat])), 16), 512)
    z = np.linspace(0.0, high - low, points)
    rows = []
    for curve, zero in zip(_each(curves.ways), zeros, strict=True):
        is_force = quantity in ("force", "voltage")
        base = _baseline(curve[0], wanted.free_share) if is_force and wanted.correct != "nothing" else 0.0
        rows.append([np.interp(z + (low + zero), way_z, value - base) for way_z, value in curve])
    nx, ny = len(curves.ways), len(curves.ways[0])
    values = np.moveaxis(np.array(rows).reshape(nx, ny, -1, points), 2, 3)
    (width, depth) = curves.sides_m
    facts |= {"length_unit": "m", "z": z, **{n: _middles(s, c) for n, s, c in (("x", width, nx), ("y", depth, ny))}}
    deepest = math.fsum(way[0][-1] - way[0][0] for way in flat) / len(flat)
    kept = f"{100.0 * (high - low) / deepest:.0f} % of the height of its curves is common to all"
    return ImportedMap(checked_map(facts, values), (*curves.notes, kept))


def _each(ways: list[list[list[Way]]]) -> Iterable[list[Way]]:
    return (curve for column in ways for curve in column)


def _common(curves: Iterable[tuple[list[Way], float]]) -> tuple[float, float]:
    """Return the range of heights [m] that all branches of all curves share, each less its zero."""
    ends = [(z[0] - zero, z[-1] - zero) for curve, zero in curves for z, _ in curve]
    return max(float(low) for low, _ in ends), min(float(high) for _, high in ends)


def _baseline(way: Way, share: float) -> float:
    """Return the mean force in the part of an approach that is farthest from the sample."""
    values: npt.NDArray[np.float64] = way[1][len(way[1]) - max(int(share * len(way[1])), 1) :]
    return math.fsum(values.tolist()) / len(values) if share > 0.0 else 0.0


def _middles(side_m: float, count: int) -> Array:
    return np.asarray((np.arange(count) + 0.5 - 0.5 * count) * (side_m / count), dtype=np.float64)

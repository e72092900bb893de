"""Read Nanosurf files: images, force curves and thermal spectra (.nid), images and force curves (.nhf).

A .nid consists of sections of `key=value`, the bytes `#!`, and then the integers of each data set in the order of the
section `DataSet`; the full range of an integer spans `Dim2Min` to `Dim2Min + Dim2Range`. Curves are stored towards the
sample, also those of the retraction, and those of a map in rows that go back and forth. A .nhf is HDF5 with the range
of each signal as attributes; its reader was written without a real file at hand.
"""

import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from telenano_lab.afm_files.recorded import Curves, RecordedCurve

Array = npt.NDArray[np.float64]
Found = tuple[dict[str, Any], list[npt.NDArray[Any]]]
Sections = dict[str, dict[str, str]]

# Names of frames in a .nid.
_FORWARD = "Spec forward"
_BACKWARD = "Spec backward"
_SPECTRUM = "Spectrum FFT"
_HEIGHT = re.compile(r"z-?axis ?sensor|position z", re.IGNORECASE)


class DataSet(NamedTuple):
    """Lines of a channel: frame (such as `Scan forward`), name, unit, values of shape (lines, points), section."""

    frame: str
    name: str
    unit: str
    values: Array
    facts: dict[str, str]


def sections_of(path: str) -> tuple[Sections, list[DataSet]]:
    """Return the sections of a .nid and its data sets.

    Raises:
        ValueError: The file is no .nid, or its data differ in size from its header.
    """
    content = Path(path).read_bytes()
    head, mark, data = content.partition(b"#!")
    sections: Sections = {}
    for line in head.decode("utf-8", "replace").splitlines():
        if line.startswith("["):
            section = sections.setdefault(line.strip("[]"), {})
        elif sections:
            key, _, value = line.partition("=")
            section[key] = value.strip()
    if not mark or "DataSet" not in sections:
        raise ValueError("is not a file of Nanosurf: it has no section DataSet, or no data after it")
    named = [value for key, value in sections["DataSet"].items() if re.fullmatch(r"Gr\d+-Ch\d+", key)]
    sizes = [[int(sections[name][key]) for key in ("Lines", "Points", "SaveBits")] for name in named]
    stated = sum(lines * points * bits // 8 for lines, points, bits in sizes)
    if min(map(min, sizes), default=0) < 1 or stated != len(data):
        raise ValueError(
            f"is not a complete file of Nanosurf: it has {len(data)} bytes of data, its header states {stated}"
        )
    found, place = [], 0
    for name, (lines, points, bits) in zip(named, sizes, strict=True):
        facts = sections[name]
        if bits not in (8, 16, 32) or facts.get("SaveSign", "Signed") != "Signed":
            raise ValueError(f"[{name}] has integers of {bits} bits ({facts.get('SaveSign')}), which are not read")
        raw = np.frombuffer(data, f"<i{bits // 8}", lines * points, place).reshape(lines, points)
        place += raw.nbytes
        values = (raw / 2.0**bits + 0.5) * float(facts["Dim2Range"]) + float(facts["Dim2Min"])
        found.append(DataSet(facts["Frame"], facts["Dim2Name"], facts.get("Dim2Unit", ""), values, facts))
    return sections, found


def load_maps(path: str) -> Found:
    """Return the maps of the images in a .nid; y rises with the row."""
    facts, maps = [], []
    for one in sections_of(path)[1]:
        if one.frame.lower().endswith(("scan forward", "scan backward")):
            sides = [float(one.facts[f"Dim{axis}Range"]) for axis in (0, 1)]
            name = f"{one.name} {one.frame.lower().replace('scan ', '')}"
            facts.append({"name": name, "sides": sides, "unit": one.facts.get("Dim0Unit", ""), "z": one.unit})
            maps.append(one.values)
    if not maps:
        raise ValueError("has no image; `telenano curve --overlay` reads its curves, `calibrate stiffness` a spectrum")
    return {"channels": facts}, maps


def load_spectrum(path: str) -> Found:
    """Return a thermal spectrum: frequencies [Hz] and density, with its unit and the number of averages."""
    sections, channels = sections_of(path)
    one = next((each for each in channels if each.frame == _SPECTRUM), None)
    if one is None:
        raise ValueError(f"has no thermal spectrum; it has {', '.join(sorted({each.frame for each in channels}))}")
    start, span = (float(one.facts[f"Dim0{key}"]) for key in ("Min", "Range"))
    frequency = np.linspace(start, start + span, one.values.shape[1])
    averages = sections.get("DataSet-Info", {}).get("Averages", "")
    return {"unit": one.unit, "averages": int(averages) if averages.isdecimal() else 1}, [frequency, one.values[0]]


def curves_of_nid(path: str) -> Curves:
    """Return the force curves of a .nid."""
    sections, channels = sections_of(path)
    by_frame = {frame: [each for each in channels if each.frame == frame] for frame in (_FORWARD, _BACKWARD)}
    if not all(by_frame.values()):
        raise ValueError(f"has no force curves; it has {', '.join(sorted({each.frame for each in channels}))}")
    places, sides = _grid_of(sections, len(by_frame[_FORWARD][0].values))
    lever = re.match(r"D\[([^\]]*)\]\*\[N/m\]", sections.get(r"DataSet\Calibration\Cantilever", {}).get("Prop0", ""))
    stiffness = float(lever[1]) if lever else None
    deflections = {frame: _named(sets, "deflection") for frame, sets in by_frame.items()}
    sensors = {
        frame: next((each for each in sets if _HEIGHT.search(each.name)), None) for frame, sets in by_frame.items()
    }

    def way(frame: str, number: int) -> tuple[Array, Array]:
        one, sensor = deflections[frame], sensors[frame]
        points = int(one.facts.get(f"LineDim{number}Points") or one.values.shape[1])
        if sensor is not None and sensor.unit == "m":
            z = sensor.values[number, :points]
        else:
            own = f"LineDim{number}" if f"LineDim{number}Min" in one.facts else "Dim0"
            start, span = (float(one.facts[f"{own}{key}"]) for key in ("Min", "Range"))
            z = np.linspace(start, start + span, points)
        order = slice(None) if frame == _FORWARD else slice(None, None, -1)
        return -z[order], one.values[number, :points][order]

    def curve(number: int) -> RecordedCurve:
        ways = (way(_FORWARD, number), way(_BACKWARD, number))
        return RecordedCurve(places[number], ways, deflections[_FORWARD].unit, stiffness)

    shape = (1 + max(i for i, _ in places), 1 + max(j for _, j in places))
    return Curves(shape, sides, ((partial(curve, n), (n + 1) / len(places)) for n in range(len(places))))


def _named(sets: list[DataSet], name: str) -> DataSet:
    for one in sets:
        if one.name.lower() == name:
            return one
    raise ValueError(f"its curves have no {name}; they have {', '.join(one.name for one in sets)}")


def _grid_of(sections: Sections, count: int) -> tuple[list[tuple[int, int]], tuple[float, float]]:
    """Return column and row of each curve and the sides of the grid [m]; without a grid, one line with sides of 0."""
    table = sections.get(r"DataSet\SpecInfos\SpecMapTable", {}).get("Map0", "").split(";")
    if len(table) >= 6:
        x0, x1, y0, y1 = map(float, table[:4])
        nx, ny = (int(float(part)) for part in table[4:6])
        if nx * ny == count:
            places = [(i if j % 2 == 0 else nx - 1 - i, j) for j in range(ny) for i in range(nx)]
            # The points are the centres of the cells.
            return places, ((x1 - x0) * nx / max(nx - 1, 1), (y1 - y0) * ny / max(ny - 1, 1))
    return [(number, 0) for number in range(count)], (0.0, 0.0)


def load_nhf_maps(path: str) -> Found:
    """Return the maps of the images in a .nhf; y rises with the row."""
    import h5py

    facts, maps = [], []
    with h5py.File(path, "r") as file:
        for group in _groups(file):
            shape = group.attrs.get("rect_axis_size", [group.attrs.get(f"image_{key}") for key in
                                                       ("number_of_lines", "points_per_line")])  # fmt: skip
            sides = group.attrs.get("rect_axis_range", [group.attrs.get(f"image_size_{axis}") for axis in "yx"])
            if None in list(shape) or None in list(sides):
                continue
            rows, columns = map(int, shape)
            for segment in _groups(group):
                way = _text(segment.attrs.get("segment_name", segment.attrs.get("name", "")))
                for one in segment.values():
                    if isinstance(one, h5py.Dataset) and one.size == rows * columns and (name := _signal(one)):
                        facts.append({"name": f"{name} {way}".strip(), "sides": [float(sides[1]), float(sides[0])],
                                      "unit": "m", "z": _signal_unit(one)})  # fmt: skip
                        maps.append(_scaled(one).reshape(rows, columns))
    if not maps:
        raise ValueError("has no image; `telenano curve --overlay` reads its curves")
    return {"channels": facts}, maps


def curves_of_nhf(path: str) -> Curves:
    """Return the force curves of a .nhf, whose segments hold the samples of all curves one after another."""
    import h5py

    with h5py.File(path, "r") as file:
        for group in _groups(file):
            segments = sorted((each for each in _groups(group) if "segment_index" in each.attrs),
                              key=lambda each: int(each.attrs["segment_index"]))  # fmt: skip
            if segments and "rect_axis_size" in group.attrs:
                shape = tuple(map(int, group.attrs["rect_axis_size"]))[::-1]
                sides = tuple(map(float, group.attrs.get("rect_axis_range", (0.0, 0.0))))[::-1]
                lever, way = (group.attrs.get(f"spm_probe_calibration_{key}") for key in
                              ("spring_constant", "deflection_sensitivity"))  # fmt: skip
                chosen = (segments[0], segments[-1])
                parts = [[*_segment(segment, shape[0] * shape[1])] for segment in chosen]
                unit = _signal_unit(_dataset(chosen[0], "Deflection"))
                break
        else:
            raise ValueError("has no force curves")
    nx, ny = shape
    stiffness, sensitivity = (None if value is None else float(value) for value in (lever, way))

    def curve(number: int) -> RecordedCurve:
        i, j = number % nx, number // nx
        return RecordedCurve((i, j), tuple(part[number] for part in parts), unit, stiffness, sensitivity)

    return Curves((nx, ny), (sides[0], sides[1]), ((partial(curve, n), (n + 1) / (nx * ny)) for n in range(nx * ny)))


def _segment(segment: Any, count: int) -> Iterator[tuple[Array, Array]]:
    """Yield height [m], rising away from the sample, and deflection of each curve of a segment."""
    z, deflection = (_scaled(_dataset(segment, name)) for name in ("Position Z", "Deflection"))
    blocks = next((np.asarray(each) for each in segment.values() if "dataset_block_size_id" in each.attrs), None)
    sizes = np.full(count, z.size // count) if blocks is None else blocks.astype(int).ravel()
    if len(sizes) != count or int(sizes.sum()) > min(z.size, deflection.size) or sizes.min() < 1:
        raise ValueError(f"its segment has {z.size} samples, and {len(sizes)} curves of {int(sizes.sum())} in all")
    end = 0
    for size in sizes.tolist():
        cut, end = slice(end, end + size), end + size
        yield -z[cut], deflection[cut]


def _groups(group: Any) -> Iterator[Any]:
    return (each for each in group.values() if not hasattr(each, "shape"))


def _dataset(segment: Any, name: str) -> Any:
    for each in segment.values():
        if _signal(each) == name:
            return each
    raise ValueError(f"its curves have no {name}; they have {', '.join(filter(None, map(_signal, segment.values())))}")


def _signal(dataset: Any) -> str:
    return _text(dataset.attrs.get("signal_name", dataset.attrs.get("name", "")))


def _signal_unit(dataset: Any) -> str:
    unit = dataset.attrs.get("signal_calibration_unit", dataset.attrs.get("base_calibration_unit", ""))
    return _text(unit).strip("[] ")


def _scaled(dataset: Any) -> Array:
    """Return the values of a signal; the full range of its integer type spans its calibrated range."""
    values = np.asarray(dataset)
    ends = [dataset.attrs.get(f"{key}_calibration_{end}") for end in ("min", "max") for key in ("signal", "base")]
    least, most = (next((float(end) for end in pair if end is not None), None) for pair in (ends[:2], ends[2:]))
    if values.dtype.kind not in "iu" or least is None or most is None:
        return values.astype(np.float64)
    kind = np.iinfo(values.dtype)
    return (values.astype(np.float64) - kind.min) * ((most - least) / (float(kind.max) - kind.min)) + least


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)

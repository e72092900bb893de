"""Files of several makers with a known content, written from the descriptions of the formats, for tests."""

import struct
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

STIFFNESS_N_PER_M = 2.0
HEIGHTS = np.add.outer(np.linspace(0.0, 9e-9, 10), np.linspace(0.0, 4e-9, 16) ** 2 / 4e-9)


def adhesive(z_m: Any) -> tuple[Any, Any]:
    """Return the forces [N] of an approach with a snap-in at 4 nm and of a retraction that detaches at 9 nm."""
    z = np.asarray(z_m, dtype=np.float64)
    contact = 1.0e-9 * (3e-9 - z) / 1e-9
    down = np.where(z > 4e-9, 0.0, contact)
    return down, np.where(z > 9e-9, 0.0, np.maximum(contact, -5e-9))


# A curve of 200 points each way: height above the sample [m], from far to near, and the force on the tip [N] both ways.
HEIGHT_M = np.linspace(20e-9, 0.0, 200)
DOWN_N, UP_N = adhesive(HEIGHT_M)
SENSITIVITY_M_PER_V = 50e-9


def wave(
    values: Any, *, unit: str = "m", side_unit: str = "m", labels: tuple[tuple[int, str], ...] = (), note: str = ""
) -> bytes:
    """Return an Igor binary wave of version 5; labels are pairs of dimension and label."""
    data = np.asarray(values, "<f4").tobytes(order="F")
    texts = [b"".join(text.encode().ljust(32, b"\0") for at, text in labels if at == place) for place in range(4)]
    texts = [b"\0" * 32 + text if text else b"" for text in texts]
    sides = [*np.shape(values), 0, 0, 0][:4]
    head = bytearray(384)
    struct.pack_into(
        "<hhiiii4i4i3i", head, 0, 5, 0, 320 + len(data), 0, len(note), 0, 0, 0, 0, 0, *map(len, texts), 0, 0, 0
    )
    struct.pack_into("<ih", head, 76, int(np.prod(np.shape(values))), 2)
    struct.pack_into("<4i4d", head, 132, *sides, 1e-8, 1e-8, 1.0, 1.0)
    struct.pack_into("<4s", head, 212, unit.encode())
    for place in range(2):
        struct.pack_into("<4s", head, 216 + 4 * place, side_unit.encode())
    # The checksum makes the sum of the 16-bit words of both headers zero.
    total = sum(struct.unpack("<192h", bytes(head)))
    struct.pack_into("<H", head, 2, -total & 0xFFFF)
    return bytes(head) + data + note.encode() + b"".join(texts)


def write_nid(path: Path, sets: list[tuple[dict[str, object], np.ndarray]], **sections: str) -> Path:
    """Write Nanosurf data sets, each with its facts and values of shape (lines, points), as integers of 32 bits."""
    head = ["[DataSet]", "Version=2", f"GroupCount={len(sets)}"]
    for place, (facts, _) in enumerate(sets):
        head += [f"Gr{place}-Name={facts['Frame']}", f"Gr{place}-ID=0", f"Gr{place}-Count=1"]
        head += [f"Gr{place}-Ch0=DataSet-{place}:0"]
    data = b""
    for place, (facts, values) in enumerate(sets):
        low, span = float(values.min()), float(np.ptp(values)) or 1.0
        raw = np.round((values - low) / span * (2.0**32 - 1.0) - 2.0**31).astype("<i4")
        own = {"Points": values.shape[1], "Lines": len(values), "SaveMode": "Binary", "SaveBits": 32,
               "SaveSign": "Signed", "SaveOrder": "Intel", "Version": 2,
               "Dim2Range": span * (1.0 + 2.0**-32), "Dim2Min": low, **facts}  # fmt: skip
        head += ["", f"[DataSet-{place}:0]", *(f"{key}={value}" for key, value in own.items())]
        data += raw.tobytes()
    for name, lines in sections.items():
        head += ["", f"[{name.replace('__', chr(92))}]", *lines.split("|")]
    path.write_bytes(("\r\n".join(head) + "\r\n\r\n").encode() + b"#!" + data)
    return path


def write_nid_map(path: Path, nx: int, ny: int) -> Path:
    """Write a Nanosurf map of curves whose heights shift by 1 nm from column to column."""
    rows: dict[str, list[np.ndarray]] = {"z": [], "down": [], "up": []}
    for j in range(ny):
        for i in range(nx) if j % 2 == 0 else reversed(range(nx)):
            rows["z"].append(3e-6 + 1e-9 * i - HEIGHT_M)
            rows["down"].append(DOWN_N)
            # The way back is stored towards the sample, too.
            rows["up"].append(UP_N)
    sets = []
    for frame, name in (("Spec forward", "down"), ("Spec backward", "up")):
        facts = {"Frame": frame, "Dim0Name": "Z-Axis", "Dim0Unit": "m", "Dim0Min": 0, "Dim0Range": 20e-9}
        sets.append(({**facts, "Dim2Name": "Deflection", "Dim2Unit": "N"}, np.array(rows[name])))
        sets.append(({**facts, "Dim2Name": "Z-Axis Sensor", "Dim2Unit": "m"}, np.array(rows["z"])))
    side = [0.5 * 40e-9 * (count - 1) for count in (nx, ny)]
    return write_nid(
        path, sets,
        DataSet__Calibration__Cantilever=f"Prop0=D[{STIFFNESS_N_PER_M}]*[N/m]",
        DataSet__SpecInfos__SpecMapTable=f"Count=1|Map0={-side[0]};{side[0]};{-side[1]};{side[1]};{nx};{ny};0;1",
    )  # fmt: skip


def write_nhf(path: Path) -> Path:
    """Write an image and a map of 3 x 2 curves as Nanosurf HDF5; the number of samples differs between curves."""
    import h5py

    def signal(group: "h5py.Group", name: str, unit: str, values: np.ndarray) -> None:
        low, high = float(values.min()), float(values.max())
        raw = np.round((values - low) / (high - low) * (2.0**32 - 1.0) - 2.0**31).astype("<i4")
        group[name.replace(" ", "_")] = raw.ravel()
        group[name.replace(" ", "_")].attrs.update({
            "signal_name": name, "signal_calibration_unit": unit, "signal_calibration_min": low,
            "signal_calibration_max": high, "dataset_element_type": "int32",
        })  # fmt: skip

    with h5py.File(path, "w") as file:
        file.attrs["nsf_file_version_major"] = 2
        image = file.create_group("group_0000")
        image.attrs.update({"group_type": "image_line_based", "rect_axis_size": [10, 16]})
        image.attrs["rect_axis_range"] = [100e-9, 160e-9]
        scan = image.create_group("subgroup_0000")
        scan.attrs["segment_name"] = "Forward"
        signal(scan, "Topography", "m", HEIGHTS)
        curves = file.create_group("group_0001")
        curves.attrs.update({"group_type": "spectroscopy", "rect_axis_size": [2, 3], "rect_axis_range": [2e-8, 4e-8]})
        curves.attrs["spm_probe_calibration_spring_constant"] = STIFFNESS_N_PER_M
        curves.attrs["spm_probe_calibration_deflection_sensitivity"] = SENSITIVITY_M_PER_V
        for number, (name, force) in enumerate((("Advance", DOWN_N), ("Retract", UP_N[::-1]))):
            segment = curves.create_group(f"subgroup_{number:04}")
            segment.attrs.update({"segment_name": name, "segment_index": number})
            # Position Z rises towards the sample.
            height = HEIGHT_M if number == 0 else HEIGHT_M[::-1]
            cuts = [slice(None, 200 - 2 * place) if number == 0 else slice(2 * place, None) for place in range(6)]
            signal(segment, "Position Z", "m", np.concatenate([-height[cut] for cut in cuts]))
            volts = force / STIFFNESS_N_PER_M / SENSITIVITY_M_PER_V
            signal(segment, "Deflection", "V", np.concatenate([volts[cut] for cut in cuts]))
            segment["blocks"] = np.array([200 - 2 * place for place in range(6)])
            segment["blocks"].attrs["dataset_block_size_id"] = 1
    return path


def write_nanonis_dat(path: Path, columns: dict[str, np.ndarray], experiment: str = "Z spectroscopy") -> Path:
    """Write a Nanonis spectroscopy with these columns."""
    rows = ["\t".join(columns)]
    rows += ["\t".join(f"{1e12 * value:.8f}E-12" if np.isfinite(value) else "NaN" for value in row)
             for row in zip(*columns.values(), strict=True)]  # fmt: skip
    head = f"Experiment\t{experiment}\t\r\nDate\t01.01.2026 10:00:00\t\r\nCutoff frq\t0,01\t\r\n\r\n[DATA]\r\n"
    path.write_bytes((head + "\r\n".join(rows) + "\r\n").encode())
    return path


def write_afm_workshop_map(path: Path, nx: int, ny: int) -> Path:
    """Write a map of AFM Workshop, an archive with a text file per curve and without constants."""
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(nx * ny):
            x, y = 1.0 + 0.04 * (number % nx), 2.0 + 0.04 * (number // nx)
            volts = [force / STIFFNESS_N_PER_M / SENSITIVITY_M_PER_V for force in (DOWN_N, UP_N[::-1])]
            z = 9000.0 - 1e9 * HEIGHT_M
            rows = [
                f"{a:.6f},{b:.9f},{c:.6f},{d:.9f}" for a, b, c, d in zip(z, volts[0], z[::-1], volts[1], strict=True)
            ]
            head = ["Force-Distance Curve", "File Format:\t3", "", "Date:\tThursday, January 1, 2026",
                    "Time:\t1:07:00 PM", "Mode:\tMapping", f"Point:\t{number + 1}", f"X, um:\t{x}", f"Y, um:\t{y}", "",
                    "Extend Z-Sense(nm),Extend T-B(V),Retract Z-Sense(nm),Retract T-B(V)"]  # fmt: skip
            archive.writestr(f"FD_mapping.{number:02}.csv", "\r\n".join([*head, *rows]) + "\r\n")
    return path


def write_nanoscope(path: Path, side: int = 1, *, factor: int = 1, capture: str = "Never", points: int = 200) -> Path:
    """Write a Bruker force curve, or a volume of side x side curves, as integers of 32 bits in steps of 0.1 mV."""
    volts = [force / STIFFNESS_N_PER_M / SENSITIVITY_M_PER_V for force in (DOWN_N, UP_N)]
    # Both ways are stored from the sample away.
    one = np.concatenate([np.round(way[::-1] / 1e-4) for way in volts]).astype("<i4") * factor
    data = np.tile(one, side * side).tobytes()
    lines = [
        "\\*Force file list", "\\Version: 0x09300000", "\\*Scanner list", "\\@Sens. Zsens: V 10.0000 nm/V",
        "\\*Ciao scan list", f"\\Operating mode: {'Force' if side == 1 else 'Force Volume'}", "\\Scan Size: 0.12 ~m",
        f"\\PeakForce Capture: {capture}", f"\\@Sens. DeflSens: V {1e9 * SENSITIVITY_M_PER_V} nm/V",
        "\\*Ciao force list", f"\\force/line: {side}", "\\*Ciao force image list", "\\Data offset: 4096",
        f"\\Data length: {len(data)}", "\\Bytes/pixel: 2", f"\\Samps/line: {points} 200",
        f"\\Spring Constant: {STIFFNESS_N_PER_M}", '\\@4:Image Data: S [DeflectionError] "Deflection Error"',
        "\\@4:Z scale: V [Sens. DeflSens] (0.0001 V/LSB) 2.5 V", "\\@4:Ramp Size: V [Sens. Zsens] (0.006 V/LSB) 2.0 V",
        "\\*File list end",
    ]  # fmt: skip
    path.write_bytes("\r\n".join(lines).encode("latin-1").ljust(4096, b"\0") + data)
    return path


def write_jpk_hdf5(path: Path) -> Path:
    """Write an image of JPK in HDF5: two frames of heights, and the error signal in volts."""
    import h5py

    with h5py.File(path, "w") as file:
        file.attrs["file-format-info"] = np.bytes_("JPK SCAN")
        measurement = file.create_group("Measurement_000")
        grid = {"ilength": 16, "jlength": 10, "ulength": 160e-9, "vlength": 100e-9}
        measurement.attrs.update({f"position-pattern.grid.{key}": value for key, value in grid.items()})
        for number, (name, unit, factor) in enumerate((("Error Signal", "V", 1e-9), ("Height", "m", -2e-13))):
            channel = measurement.create_group(f"Channel_{number:03}")
            channel.attrs.update({
                "channel.fancy-name": np.bytes_(name), "retrace": np.bytes_("false"),
                "net-encoder.scaling.unit.unit": np.bytes_(unit), "net-encoder.scaling.multiplier": factor,
                "net-encoder.scaling.offset": 3e-7,
            })  # fmt: skip
            frames = [np.round((HEIGHTS * times - 3e-7) / factor).ravel() for times in (1.0, 2.0)]
            channel[name.split()[0]] = np.array(frames).T.astype("<i4")
            channel["thumbnail"] = np.zeros((4, 1), dtype="<i4")
    return path


def write_nsid(path: Path, unit: str = "nm") -> Path:
    """Write an image as pyNSID does: a dataset with a dimension scale for each axis, x before y."""
    import h5py

    with h5py.File(path, "w") as file:
        group = file.create_group("Measurement_000/Channel_000/topo")
        group["topo"] = 1e9 * HEIGHTS.T
        group["topo"].attrs.update({"quantity": "Height", "units": unit, "data_type": "IMAGE"})
        for place, (name, count) in enumerate((("x", 16), ("y", 10))):
            group[name] = 10.0 * np.arange(count)
            group[name].attrs["units"] = "nm"
            group[name].make_scale(name)
            group["topo"].dims[place].label = name
            group["topo"].dims[place].attach_scale(group[name])
    return path

"""Files from strangers: one whole file of each format, damage done to it, and a process that reads them within bounds.

Run with a format and paths it reads each, and prints what came of it as JSON: `read`, a sentence, or a traceback.
"""

import json
import resource
import struct
import sys
import time
import traceback
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

# the process ends here rather than the machine; what may be taken is asserted and far less
_HIGHEST_BYTES = 4 << 30
HEIGHTS = np.random.default_rng(5).normal(0.0, 3e-9, (8, 8)).astype("<f4")


# --- whole files, as small as they can be ---


def map_wave() -> bytes:
    from telenano_lab.doubles.maker_files import wave

    return wave(HEIGHTS[:, :, None], labels=((2, "HeightTrace"),))


def curve_wave() -> bytes:
    from telenano_lab.doubles.maker_files import wave

    base = np.concatenate([np.linspace(0, 1e-7, 20), np.linspace(1e-7, 0, 20)])
    columns = np.stack([base, 0.1 * base, base], axis=1)
    note = "SpringConstant:1.5\rIndexes:0,19,39"
    return wave(columns, labels=((1, "Raw"), (1, "Defl"), (1, "ZSnsr")), note=note)


def gwy_object(name: str, *parts: bytes) -> bytes:
    data = b"".join(parts)
    return name.encode() + b"\0" + struct.pack("<I", len(data)) + data


def gwy_part(name: str, kind: str, value: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + value


def gwy(**changed: bytes | None) -> bytes:
    """Return a Gwyddion file with a map; `changed` are other bytes for a part of the map, None for none."""
    unit = gwy_object("GwySIUnit", gwy_part("unitstr", "s", b"m\0"))
    heights = HEIGHTS.astype("<f8")
    parts: dict[str, bytes | None] = {
        "xres": gwy_part("xres", "i", struct.pack("<i", 8)),
        "yres": gwy_part("yres", "i", struct.pack("<i", 8)),
        "xreal": gwy_part("xreal", "d", struct.pack("<d", 1e-7)),
        "yreal": gwy_part("yreal", "d", struct.pack("<d", 1e-7)),
        "si_unit_xy": gwy_part("si_unit_xy", "o", unit),
        "si_unit_z": gwy_part("si_unit_z", "o", unit),
        "data": gwy_part("data", "D", struct.pack("<I", heights.size) + heights.tobytes()),
    }
    field = gwy_object("GwyDataField", *(part for part in (parts | changed).values() if part is not None))
    title = gwy_part("/0/data/title", "s", b"Height\0")
    return b"GWYP" + gwy_object("GwyContainer", title, gwy_part("/0/data", "o", field))


def gsf() -> bytes:
    head = b"Gwyddion Simple Field 1.0\nXRes = 8\nYRes = 8\nXReal = 1e-07\nYReal = 1e-07\nXYUnits = m\nZUnits = m\n"
    return head + b"\0" * (4 - len(head) % 4) + HEIGHTS.tobytes()


def npy_head(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def npy() -> bytes:
    return npy_head((8, 8), "<f4") + HEIGHTS.tobytes()


def write_hdf5(path: Path) -> None:
    from telenano_lab.microscopy.force_curve import Curve, Half
    from telenano_lab.microscopy.force_curve import write_hdf5 as write

    base = np.linspace(-1e-7, 0, 20)
    there, back = (Half(way, 0.1 * way, 0.15 * way) for way in (base, base[::-1]))
    write(path, Curve(there, back, 1.5, 0.0, 1e-7, "measured"))


def write_table(path: Path) -> None:
    import afmformats

    write_hdf5(path.with_name("whole.h5"))
    afmformats.load_data(path.with_name("whole.h5"))[0].export_data(path, fmt="tab")


def write_archive(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("header.properties", "force-scan-series.header.position-index=0\n")
        file.writestr("segments/0/segment-header.properties", "force-segment-header.num-points=4\n")


def write_grid(path: Path) -> None:
    """Write a recorded map: two columns of ten frequency shifts."""
    axes = {"x": np.arange(2) * 1e-9, "y": np.zeros(1), "z": np.arange(10) * 1e-10}
    np.savez(path, value=np.full((2, 1, 10), -3.0), unit="Hz", length_unit="m", **axes)


def nanonis_grid() -> bytes:
    head = (
        'Grid dim="2 x 1"\r\nGrid settings=0;0;2E-9;1E-9;0\r\nSweep Signal="Z (m)"\r\n'
        'Fixed parameters="Sweep Start;Sweep End"\r\nExperiment parameters="X (m);Z (m)"\r\n# Parameters (4 byte)=4\r\n'
        'Points=10\r\nChannels="Frequency Shift (Hz)"\r\n:HEADER_END:\r\n'
    )
    curve = np.concatenate([[1e-9, 0.0, 0.0, 0.0], np.linspace(-1.0, -3.0, 10)])
    return head.encode() + np.tile(curve, 2).astype(">f4").tobytes()


def mcap_record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def mcap_text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def mcap_channel(number: int, topic: str) -> bytes:
    return mcap_record(4, struct.pack("<HH", number & 0xFFFF, 0) + mcap_text(topic) + mcap_text("json") + bytes(4))


def mcap_chunk(compression: str, stored: bytes, size: int, crc: int = 0) -> bytes:
    head = struct.pack("<QQQI", 1, 2, size, crc) + mcap_text(compression) + struct.pack("<Q", len(stored))
    return mcap_record(6, head + stored)


def mcap(*records: bytes, summary: bytes = b"") -> bytes:
    magic = b"\x89MCAP0\r\n"
    head, end = mcap_record(1, mcap_text("") + mcap_text("test")), mcap_record(15, bytes(4))
    return magic + head + b"".join(records) + end + summary + mcap_record(2, bytes(20)) + magic


def mcap_whole() -> bytes:
    content = mcap_channel(1, "a") + mcap_record(5, struct.pack("<HIQQ", 1, 0, 1, 1) + b"{}")
    return mcap(mcap_chunk("", content, len(content), zlib.crc32(content)))


def yaml() -> bytes:
    return b"name: mine\ndescription: a text\nduration_s: 1.0\ncontroller: {law: wave, scales: &a [1.0, 2.0]}\nx: *a\n"


def of_maker(name: str, *arguments: object) -> Callable[[Path], Any]:
    """Return what writes a file by the function of a name in the tests of telenano-lab."""

    def write(path: Path) -> None:
        from telenano_lab.doubles import maker_files

        getattr(maker_files, name)(path, *arguments)

    return write


def copy_of(path: str) -> Callable[[Path], Any]:
    """Return what copies a file of this repository."""
    return lambda target: target.write_bytes((Path(__file__).parents[2] / path).read_bytes())


def key() -> bytes:
    return b'metadata\ncurve\n    public-key = "' + b"0" * 40 + b'"\n    secret-key = "' + b"1" * 40 + b'"\n'


def write_trial(path: Path) -> None:
    from telenano_devices.acceptance.trial.trial_file import Acceptance, Line, Problem, Trial
    from telenano_devices.acceptance.trial.trial_file import write_trial as write

    lines = [Line("rate", "read only", "pass", "1000 Hz", "990 Hz at least")] * 5
    acceptance = Acceptance(1, "simulated", "a device", "pass", 12.0, lines)
    write(path, Trial(acceptance, {"telenano": "0.1.0"}, [Problem("device", "a sentence", ["a:1", "b:2"])], None))


WRITE: dict[str, Callable[[Path], Any]] = {
    "map.ibw": lambda path: path.write_bytes(map_wave()),
    "map.gwy": lambda path: path.write_bytes(gwy()),
    "map.gsf": lambda path: path.write_bytes(gsf()),
    "map.npy": lambda path: path.write_bytes(npy()),
    "curve.ibw": lambda path: path.write_bytes(curve_wave()),
    "curve.h5": write_hdf5,
    "curve.tab": write_table,
    "curve.jpk-force": write_archive,
    "curve.nid": of_maker("write_nid_map", 2, 2),
    "curve.nhf": of_maker("write_nhf"),
    "curve.spm": of_maker("write_nanoscope"),
    "grid.dat": of_maker(
        "write_nanonis_dat", {"Z rel (m)": np.arange(9) * 1e-10, "Frequency Shift (Hz)": -np.arange(9.0)}
    ),
    "map.h5-jpk": of_maker("write_jpk_hdf5"),
    "grid.npz": write_grid,
    "grid.3ds": lambda path: path.write_bytes(nanonis_grid()),
    "session.mcap": lambda path: path.write_bytes(mcap_whole()),
    "scenario.yaml": lambda path: path.write_bytes(yaml()),
    "trial.zip": write_trial,
    "profile.yaml": copy_of("telenano/settings/networks/4g.yaml"),
    "plan.yaml": copy_of("packages/telenano-lab/telenano_lab/experiments/plans/delay_and_law.yaml"),
    "key.key_secret": lambda path: path.write_bytes(key()),
}


# --- the process that reads ---


def _read_map(path: Path) -> None:
    from telenano.sections.surface_files import read_surface

    surface = read_surface(path, size_m=1e-7 if path.suffix == ".npy" else None)
    assert np.isfinite(surface.height_m).all()


def _read_grid(path: Path) -> None:
    from telenano_lab.afm_files.map_files import MapOptions, import_map

    assert np.isfinite(import_map(path, MapOptions({})).map.values).all()


def _read_curve(path: Path) -> None:
    from telenano_lab.microscopy.force_curve import read_measured

    assert np.isfinite(read_measured(path).retract.force_n).all()


def _read_mcap(path: Path) -> None:
    from telenano.recording.reader import Recording
    from telenano.recording.rewrite import filter_recording
    from telenano.recording.verify import verify

    copy = path.with_name(f"{path.stem}.copy")
    try:
        Recording(path).info()
        verify([path])
        filter_recording(path, copy)
    finally:
        copy.unlink(missing_ok=True)


def _read_yaml(path: Path) -> None:
    from telenano.settings.config import read_yaml, validate
    from telenano.settings.scenario import Scenario

    validate(Scenario, read_yaml(path), str(path))


def _read_trial(path: Path) -> None:
    from telenano_devices.acceptance.trial.sheet import judged_again, sheet_of
    from telenano_devices.acceptance.trial.trial_file import read_trial

    trial = read_trial(path)
    assert sheet_of(trial)
    judged_again(trial)


def _read_profile(path: Path) -> None:
    from telenano.settings.config import read_yaml, validate
    from telenano.settings.network_profiles import Profile

    validate(Profile, read_yaml(path), str(path))


def _read_plan(path: Path) -> None:
    from telenano_lab.experiments.plan import load_plan

    load_plan(path)


def _read_key(path: Path) -> None:
    from telenano.testing.conformance.examination import Keys

    Keys.of("0" * 40, path)


READ = {
    "trial": _read_trial, "profile": _read_profile, "plan": _read_plan, "key": _read_key,
    "map": _read_map, "grid": _read_grid, "curve": _read_curve, "session": _read_mcap, "scenario": _read_yaml,
}  # fmt: skip


def _main(kind: str, paths: list[str]) -> None:
    from telenano.wire.errors import TelenanoError

    resource.setrlimit(resource.RLIMIT_AS, (_HIGHEST_BYTES, _HIGHEST_BYTES))
    outcomes, spent_s = [], []
    for path in paths:
        begun_s = time.process_time()
        try:
            READ[kind](Path(path))
            outcomes.append("read")
        except TelenanoError as error:
            outcomes.append(str(error))
        except BaseException:  # noqa: BLE001
            outcomes.append(traceback.format_exc())
        spent_s.append(time.process_time() - begun_s)
    children_kb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    peak_mb = [_own_peak_kb() // 1024, children_kb // 1024]
    sys.stdout.write(json.dumps({"outcomes": outcomes, "peak_mb": peak_mb, "spent_s": spent_s}))


def _own_peak_kb() -> int:
    """Return the most memory that this program had; `ru_maxrss` counts that of the process which started it as well."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))


if __name__ == "__main__":
    _main(sys.argv[1], sys.argv[2:])

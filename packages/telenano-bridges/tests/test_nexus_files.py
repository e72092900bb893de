"""Images and sessions as NeXus files: what NXafm demands is there, and the values are those of the recording."""

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import msgspec
import numpy as np
import pytest
from telenano_bridges.nexus import write_images
from telenano_lab.microscopy.image_files import Image, ImageFacts

import telenano
from telenano.recording import FileSettings, RecordingWriter, Selection, export_recording
from telenano.testing import invoke
from telenano.wire import AfmScanline, Array, RecordingError, encode

# groups of which NXafm, NXspm and NXsensor_scan demand one, with the fields that they demand in them
DEMANDED = {
    "NXentry": ("definition", "experiment_technique", "scan_mode"),
    "NXprocess": ("program",),
    "NXuser": ("name",),
    "NXinstrument": (),
    "NXfabrication": ("vendor",),
    "NXenvironment": (),
    "NXspm_scan_control": (),
    "NXspm_scan_region": (),
    "NXspm_scan_pattern": (),
    "NXdata": (),
}


def groups(file: Any) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}

    def keep(_: str, item: Any) -> None:
        if isinstance(item, h5py.Group):
            found.setdefault(item.attrs["NX_class"], []).append(item)

    file.visititems(keep)
    return found


def checked(path: Path) -> Any:
    """Return the file, opened, after what the definitions demand of every file was found in it."""
    file = h5py.File(path)
    found = groups(file)
    for kind, fields in DEMANDED.items():
        assert kind in found, f"{path} has no {kind}"
        for group in found[kind]:
            assert [name for name in fields if name not in group] == [], group.name
    entry = file[file.attrs["default"]]
    assert entry["definition"][()].decode() == "NXafm"
    assert "version" in entry["definition"].attrs
    assert entry["experiment_technique"][()].decode() == "AFM"
    assert {"version", "program_url"} <= set(entry["process/program"].attrs)
    assert entry["scanner_frame/z_direction"][()].decode() == "from sample towards probe"
    assert file[entry.attrs["default"]] if entry.attrs["default"].startswith("/") else entry[entry.attrs["default"]]
    for plot in found["NXdata"]:
        signal, axes = plot[plot.attrs["signal"]], list(plot.attrs["axes"])
        assert signal.shape == tuple(len(plot[axis]) for axis in axes)
        assert [int(plot.attrs[f"{axis}_indices"]) for axis in axes] == list(range(len(axes)))
        assert all(item.attrs["units"] for name, item in plot.items() if name != "title")
    return file


def test_a_session_becomes_tip_hand_and_force_against_distance(
    recording_of: Callable[[str], Path], tmp_path: Path
) -> None:
    path = recording_of("wave")
    said = invoke(["bag", "export", str(path), "--to", "nexus", "--out", str(tmp_path / "s.nxs"), "--json"])
    assert said.exit_code == 0, said.output
    session = telenano.open(path)
    tip, hand = session.table("afm/state"), session.table("haptic/state")
    assert json.loads(said.stdout)["messages"] == len(tip["time_s"]) + len(hand["time_s"])
    with checked(tmp_path / "s.nxs") as file:
        entry = file["entry"]
        assert np.array_equal(entry["data_tip/tip_force"], tip["tip_force_n.2"])
        assert np.allclose(entry["data_tip/time"], tip["time_s"], rtol=0.0, atol=2e-9)
        assert np.array_equal(entry["data_hand/hand_position"], hand["position_m.2"])
        assert np.array_equal(entry["data_force_distance/separation"], tip["separation_m"])
        assert entry["data_tip/tip_force"].attrs["units"] == "N"
        assert entry["instrument/cantilever/cantilever_config/spring_constant"][()] == 40.0
        assert "controller:" in entry["telenano/scenario.yaml"][()].decode()
        assert entry["user/name"][()].decode() == "not recorded"
        points = entry["instrument/scan_environment/scan_control/point_force_scan/scan_points_z"][()]
        assert points == len(tip["time_s"])
    with pytest.raises(RecordingError, match=r"s\.nxs: already exists and is not overwritten"):
        export_recording(path, tmp_path / "s.nxs", "nexus")
    with pytest.raises(RecordingError, match="a NeXus file needs afm/state, haptic/state, afm/scanline; its channels"):
        export_recording(path, tmp_path / "none.nxs", "nexus", Selection.of(["law/status"], []))
    assert not (tmp_path / "none.nxs").exists()


def scanline(number: int, direction: str, heights: list[float], lines: int = 2) -> AfmScanline:
    y = number * 10e-9
    return msgspec.convert({
            "seq": number, "t_ns": 1_700_000_000_000_000_000, "src": "afm_node@slave", "v": AfmScanline.version,
            "line": number, "lines": lines, "direction": direction, "start_m": (-15e-9, y, 0.0),
            "end_m": (15e-9, y, 0.0), "height_m": Array.from_numpy(np.array(heights)), "amplitude_m": None,
            "phase_rad": None,
        }, AfmScanline)  # fmt: skip


def test_each_image_of_a_recording_is_in_the_file_with_its_axes(tmp_path: Path) -> None:
    writer = RecordingWriter.create("recorder@slave", FileSettings(directory=tmp_path, file_name="images.mcap"))
    channel = writer.channel("afm/scanline", "afm_node@slave", "slave")
    at_ns = 1_700_000_000_000_000_000
    # two images, of which the second ended after its first line
    shown = [(0, 1e-9), (1, 3e-9), (0, 7e-9)]
    for count, (number, height) in enumerate(shown):
        for direction in ("trace", "retrace"):
            line = scanline(number, direction, [height, height + 1e-9, height + 2e-9])
            writer.write(channel, at_ns + count, at_ns + count, number, encode(line))
    writer.finish()
    export_recording(tmp_path / "images.mcap", tmp_path / "images.nxs", "nexus")
    with checked(tmp_path / "images.nxs") as file:
        height = file["entry/data_image_1_height"]
        assert height["data"].shape == (2, 3)
        assert np.allclose(height["data"][1] - height["data"][0], 2e-9, rtol=1e-9, atol=0.0)
        assert np.allclose(height["x"], [7.5e-9, 22.5e-9, 37.5e-9], rtol=1e-9, atol=0.0)
        assert np.allclose(np.diff(height["y"]), 10e-9, rtol=1e-9, atol=0.0)
        assert file["entry/data_image_2_height/data"].shape == (1, 3)
        assert "partial: 1 of 2 lines" in file["entry/data_image_2_height/title"][()].decode()
        mesh = file["entry/instrument/scan_environment/scan_control/mesh_scan"]
        assert (mesh["scan_points_x"][()], mesh["scan_points_y"][()]) == (3, 2)


def test_an_image_of_the_simulated_instrument_is_one_too(tmp_path: Path) -> None:
    heights = np.arange(12.0).reshape(3, 4) * 1e-9
    images = {"height": Image("Height", "m", heights, 40e-9, 30e-9)}
    facts = ImageFacts("tapping", "simulated AFM", "0.1.0", "dots")
    write_images(tmp_path / "scan.nxs", images, facts)
    with checked(tmp_path / "scan.nxs") as file:
        assert np.array_equal(file["entry/data_height/data"], heights)
        assert file["entry/scan_mode"][()].decode() == "tapping mode"
        assert file["entry/sample/name"][()].decode() == "dots"


@pytest.mark.endurance
def test_the_validator_of_the_field_finds_nothing_wrong(recording_of: Callable[[str], Path], tmp_path: Path) -> None:
    validator = shutil.which("pynx")
    if validator is None:
        pytest.skip("needs the command pynx: pip install pynxtools, in an environment of its own")
    export_recording(recording_of("wave"), tmp_path / "s.nxs", "nexus")
    heights = np.arange(12.0).reshape(3, 4) * 1e-9
    facts = ImageFacts("tapping", "simulated AFM", "0.1.0", "dots")
    write_images(tmp_path / "scan.nxs", {"height": Image("Height", "m", heights, 40e-9, 30e-9)}, facts)
    for name in ("s.nxs", "scan.nxs"):
        done = subprocess.run(
            [validator, "validate", str(tmp_path / name)], capture_output=True, text=True, check=False
        )
        complaints = [line for line in (done.stdout + done.stderr).splitlines() if "required" in line.lower()]
        # pynxtools 0.16 looks for the units of a field of any name at a field that is called DATA
        known = re.compile(r"/data_\w+/(DATA|AXISNAME)/@units hasn't been supplied")
        assert [line for line in complaints if not known.search(line)] == []
        assert "NXafm" in done.stdout + done.stderr
        # where the fields have these names as well, nothing is left
        with h5py.File(tmp_path / name, "a") as file:
            for plot in groups(file)["NXdata"]:
                plot["DATA"], plot["AXISNAME"] = plot[plot.attrs["signal"]], plot[plot.attrs["axes"][0]]
        done = subprocess.run(
            [validator, "validate", "--ignore-undocumented", str(tmp_path / name)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert "is valid according to the `NXafm` application definition" in done.stdout + done.stderr

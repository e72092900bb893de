"""Force curves of other instruments are read as they were written, and what cannot be used is refused by name."""

import dataclasses
import json
import zipfile
from pathlib import Path

import afmformats
import h5py
import numpy as np
import pytest
from telenano_lab.afm_files.map_files import MAP_SUFFIXES
from telenano_lab.calibration.own_calibration import sensitivities_of_file
from telenano_lab.doubles.maker_files import wave
from telenano_lab.microscopy.force_curve import Curve, Half, force_curve, marks_of, read_measured, write_hdf5

from telenano.sections import AfmConfig
from telenano.testing import invoke
from telenano.wire import ConfigError

DATA = Path(__file__).parents[5] / "shared" / "data" / "SiN_FD_plot.ibw"


def write_jpk(path, *curves, sensitivity_m_per_v=5e-8, k=40.0):
    """Write a curve, or several as a map, as an instrument of JPK does: a ZIP of properties and big-endian integers."""

    def channel(name, unit, slots, scale):
        lines = [
            f"channel.{name}.data.encoder.type=signedinteger",
            f"channel.{name}.data.encoder.scaling.offset=0.0",
            f"channel.{name}.data.encoder.scaling.multiplier={scale!r}",
            f"channel.{name}.data.encoder.scaling.unit.unit=V",
            f"channel.{name}.conversion-set.conversions.base={unit}",
        ]
        base = unit
        for slot, of, multiplier in slots:
            conversion = f"channel.{name}.conversion-set.conversion.{slot}"
            lines += [
                f"{conversion}.name={slot}",
                f"{conversion}.base-calibration-slot={base}",
                f"{conversion}.scaling.offset=0.0",
                f"{conversion}.scaling.multiplier={multiplier!r}",
                f"{conversion}.scaling.unit.unit={of}",
            ]
            base = slot
        return lines

    def write(file, within, place, curve):
        file.writestr(f"{within}header.properties", f"force-scan-series.header.position-index={place}\n")
        file.writestr(f"{within}segments/", "")
        for number, (style, half) in enumerate((("extend", curve.approach), ("retract", curve.retract))):
            folder = f"{within}segments/{number}/"
            file.writestr(folder, "")
            properties = [
                f"force-segment-header.num-points={len(half.base_m)}",
                "force-segment-header.approach-id=a",
                "force-segment-header.duration=0.5",
                "force-segment-header.time-stamp=2020-01-01 10:00:00 +0100",
                f"force-segment-header.settings.style={style}",
                "force-segment-header.settings.segment-settings.duration=0.5",
                f"force-segment-header.settings.segment-settings.z-start={float(half.base_m[0])!r}",
                f"force-segment-header.settings.segment-settings.z-end={float(half.base_m[-1])!r}",
                *channel("vDeflection", "volts", [("distance", "m", sensitivity_m_per_v), ("force", "N", k)], 1e-8),
                *channel("measuredHeight", "volts", [("nominal", "m", 1e-6)], 1e-9),
                *channel("height", "volts", [("nominal", "m", 1e-6), ("calibrated", "m", 1.0)], 1e-9),
            ]
            file.writestr(folder + "segment-header.properties", "\n".join(properties))
            volts = half.force_n / k / sensitivity_m_per_v
            heights = -half.base_m / 1e-6
            for name, values in (
                ("vDeflection", volts / 1e-8),
                ("measuredHeight", heights / 1e-9),
                ("height", heights),
            ):
                raw = np.round(values).astype(">i4").tobytes()
                file.writestr(f"{folder}channels/{name}.dat", raw)

    with zipfile.ZipFile(path, "w") as file:
        if len(curves) == 1:
            write(file, "", 0, curves[0])
            return
        grid = {"ulength": 1e-6, "vlength": 1e-6, "xcenter": 0.0, "ycenter": 0.0, "ilength": len(curves), "jlength": 1}
        place = "force-scan-map.position-pattern.grid"
        lines = [f"{place}.{name}={value!r}" for name, value in grid.items()]
        file.writestr("header.properties", "\n".join(["type=force-scan-map", *lines]) + "\n")
        file.writestr("index/", "")
        for number, curve in enumerate(curves):
            file.writestr(f"index/{number}/", "")
            write(file, f"index/{number}/", number, curve)


def test_curves_of_other_instruments_are_read_as_they_were_written(tmp_path):
    curve = force_curve(AfmConfig(), 10e-9, 10e-9, 200)
    marks = marks_of(curve)
    write_jpk(tmp_path / "curve.jpk-force", curve)
    write_hdf5(tmp_path / "curve.h5", curve)
    afmformats.load_data(tmp_path / "curve.h5")[0].export_data(tmp_path / "curve.tab", fmt="tab")
    for name in ("curve.jpk-force", "curve.tab"):
        found = read_measured(tmp_path / name)
        assert (found.stiffness_n_per_m, len(found.approach.base_m)) == (40.0, 200)
        # the files have six digits, or integers of 20 fN
        assert np.allclose(found.retract.base_m, curve.retract.base_m, rtol=0, atol=1e-13)
        # both begin where there is no force, which a measured curve is levelled to
        offset = found.approach.force_n[0] - curve.approach.force_n[0]
        assert np.allclose(found.retract.force_n - offset, curve.retract.force_n, rtol=0, atol=1e-13)
        again = marks_of(found)
        assert again.pull_off_base_m == pytest.approx(marks.pull_off_base_m, rel=0, abs=1e-12)
        assert again.hysteresis_j == pytest.approx(marks.hysteresis_j, rel=1e-3, abs=0)


def hard(seed, sensitivity_m_per_v=5e-8, k=40.0, nearest_m=1e-7):
    """Return a curve on a sample that does not give way: the deflection follows the base, with noise of 1 mV."""
    base = np.linspace(nearest_m - 3e-7, nearest_m, 400)
    noise = 1e-3 * sensitivity_m_per_v * np.random.default_rng(seed).standard_normal((2, 400))
    ways = []
    for way, own in zip((base, base[::-1]), noise, strict=True):
        zeta = np.maximum(way, 0.0) + own
        ways.append(Half(way, zeta, k * zeta))
    return Curve(*ways, k, 0.0, 1e-6, "made")


def test_a_map_gives_any_of_its_curves_and_the_sensitivity_of_each(tmp_path):
    path = tmp_path / "grid.jpk-force-map"
    far = hard(3, nearest_m=-1e-8)
    write_jpk(path, *map(hard, range(3)), far)
    assert np.allclose(read_measured(path, 3).retract.base_m, far.retract.base_m, rtol=0, atol=1e-13)
    with pytest.raises(ConfigError, match="it has no curve 4; it has 4, and the first is 0"):
        read_measured(path, 4)
    write_jpk(tmp_path / "one.jpk-force", hard(5))
    for name, key in (("one.jpk-force", "standard_error_nm_per_v"), ("grid.jpk-force-map", "deviation_nm_per_v")):
        said = invoke(["calibrate", "sensitivity", "--curve", str(tmp_path / name), "--json"])
        assert said.exit_code == 0, said.output
        document = json.loads(said.stdout)
        # the voltages are those that were read, whatever constants stand in the file
        assert document["sensitivity_nm_per_v"] == pytest.approx(50.0, rel=2e-3)
        assert document[key] > 0.0
    # the last curve of the map never meets the sample
    assert (document["curves"], document["curves_without_hard_contact"]) == (3, 1)
    write_hdf5(tmp_path / "no_sensitivity.h5", far)
    with pytest.raises(
        ConfigError, match=r"no_sensitivity\.h5: is not a file of curves: its metadata lack the sensitivity"
    ):
        sensitivities_of_file(tmp_path / "no_sensitivity.h5")
    with pytest.raises(ConfigError, match="it has no curve 1; it has 1, and the first is 0"):
        read_measured(tmp_path / "one.jpk-force", 1)


@pytest.mark.parametrize(
    "name", ["fmt-jpk-fd_map2x2_extracted.jpk-force-map", "fmt-jpk-fd_2020.02.07-16.29.05.036.jpk-qi-data"]
)
def test_public_maps_give_their_curves_and_sensitivities(name):
    path = DATA.parent / name
    if not path.exists():
        pytest.skip("measured data are not beside the project: ../shared/data")
    assert read_measured(path, 1).stiffness_n_per_m > 0.0
    found, refused = sensitivities_of_file(path)
    assert len(found) >= 1 and refused >= 0


def test_a_curve_without_spring_constant_or_way_back_is_refused_by_file(tmp_path):
    curve = force_curve(AfmConfig(), 10e-9, 10e-9, 20)
    write_hdf5(tmp_path / "curve.h5", curve)
    whole = afmformats.load_data(tmp_path / "curve.h5")[0]
    whole.export_data(tmp_path / "no_k.tab", fmt="tab", metadata=["imaging mode"])
    whole.export_data(tmp_path / "whole.tab", fmt="tab")
    lines = (tmp_path / "whole.tab").read_text().splitlines()
    data = [number for number, line in enumerate(lines) if line and not line.startswith("#")]
    (tmp_path / "half.tab").write_text("\n".join(lines[: data[19] + 1]) + "\n")
    (tmp_path / "not_a.jpk-force").write_bytes(b"PK no archive")
    for name, words in (
        ("no_k.tab", "stiffness_n_per_m: the file has no such value"),
        ("half.tab", "retraction"),
        ("not_a.jpk-force", "not a complete"),
    ):
        with pytest.raises(ConfigError, match=words) as error:
            read_measured(tmp_path / name)
        assert str(tmp_path / name) in str(error.value)


def test_a_file_that_is_no_curve_is_named(tmp_path):
    for name, content in (("a.ibw", b"x" * 400), ("a.h5", b"x"), ("a.txt", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ConfigError, match=str(tmp_path / name)):
            read_measured(tmp_path / name)


def test_damage_that_a_reader_did_not_expect_is_told_by_file(tmp_path):
    with pytest.raises(ConfigError, match=r"cut\.ibw: cannot be read: No such file"):
        read_measured(tmp_path / "cut.ibw")
    (tmp_path / "cut.ibw").write_bytes(b"IGOR")
    with pytest.raises(
        ConfigError, match=r"cut\.ibw: is not a complete force curve: it is not an Igor binary wave of version 5"
    ):
        read_measured(tmp_path / "cut.ibw")
    curve = force_curve(AfmConfig(), 10e-9, 10e-9, 20)
    write_hdf5(tmp_path / "stiff.h5", dataclasses.replace(curve, stiffness_n_per_m=-40.0))
    with pytest.raises(ConfigError, match="its spring constant is -40 N/m"):
        read_measured(tmp_path / "stiff.h5")


@pytest.mark.skipif(not DATA.exists(), reason="measured data are not beside the project: ../shared/data")
def test_a_measured_curve_is_marked():
    curve = read_measured(DATA)
    assert curve.stiffness_n_per_m == 1.1841
    assert len(curve.approach.base_m) == 1009
    marks = marks_of(curve)
    assert marks.pull_off_force_n < marks.snap_in_force_n < 0.0
    assert marks.hysteresis_j > 0.0


def write_jpk_with_pause(path, curve, kind):
    """Write a curve whose tip waits between approach and retraction, with a settling segment before for relaxation."""
    write_jpk(path, curve)
    with zipfile.ZipFile(path) as file:
        entries = {name: file.read(name) for name in file.namelist()}
    numbers = {"0": "0", "1": "2"} if kind != "constant-height-pause" else {"0": "0", "1": "3"}
    moved = {}
    for name, content in entries.items():
        parts = name.split("segments/")
        if len(parts) == 2 and parts[1]:
            number, rest = parts[1].split("/", 1)
            name = f"{parts[0]}segments/{numbers[number]}/{rest}"
        moved[name] = content
    # a wait looks as the approach does but for its kind, which is what a reader can tell it by
    for number in range(1, int(numbers["1"])):
        for name, content in entries.items():
            if "segments/0/" in name:
                if name.endswith("segment-header.properties"):
                    content = content.replace(b"settings.style=extend", b"settings.style=pause")
                    content += f"\nforce-segment-header.settings.segment-settings.type={kind}\n".encode()
                moved[name.replace("segments/0/", f"segments/{number}/")] = content
    with zipfile.ZipFile(path, "w") as file:
        for name, content in moved.items():
            file.writestr(name, content)


def write_ibw_with_dwell(path):
    base = np.concatenate([np.linspace(0, 1e-7, 20), np.full(10, 1e-7), np.linspace(1e-7, 0, 20)])
    labels = ((1, "Raw"), (1, "Defl"), (1, "ZSnsr"))
    note = "SpringConstant:1.5\rIndexes:0,19,29,49\rDirection:NaN,1,0,-1"
    path.write_bytes(wave(np.stack([base, 0.1 * base, base], axis=1), labels=labels, note=note))


def write_of_mode(path, curve, mode, segments=2):
    write_hdf5(path, curve)
    with h5py.File(path, "r+") as file:
        file["0"].attrs["imaging mode"] = mode
        count = len(file["0"]["segment"])
        file["0"]["segment"][:] = np.arange(count) * segments // count


def write_tab_of_mode(path, curve, mode):
    write_hdf5(path.with_suffix(".h5"), curve)
    afmformats.load_data(path.with_suffix(".h5"))[0].export_data(path, fmt="tab")
    path.write_text(path.read_text().replace('"force-distance"', f'"{mode}"'))


# how a curve that waits is written in a file of each ending, and what it is called
WAITING = {
    "h5": [
        (lambda path, curve: write_of_mode(path, curve, "creep-compliance"), "creep compliance"),
        (lambda path, curve: write_of_mode(path, curve, "stress-relaxation"), "stress relaxation"),
        (lambda path, curve: write_of_mode(path, curve, "force-distance", 3), "3 segments"),
    ],
    "tab": [(lambda path, curve: write_tab_of_mode(path, curve, "creep-compliance"), "creep compliance")],
    "ibw": [(lambda path, curve: write_ibw_with_dwell(path), "a dwell at the sample")],
    **{
        name: [
            (lambda path, curve: write_jpk_with_pause(path, curve, "constant-force-pause"), "creep compliance"),
            (lambda path, curve: write_jpk_with_pause(path, curve, "constant-height-pause"), "stress relaxation"),
            (lambda path, curve: write_jpk_with_pause(path, curve, "modulation-pause"), "3 segments"),
        ]
        for name in ("jpk_force", "jpk_force_map", "jpk_qi_data", "jpk_qi_series")
    },
}


@pytest.mark.check("runs three commands for each way of waiting")
@pytest.mark.drawn(0.35)
@pytest.mark.parametrize(
    ("ending", "write", "kind"), [(ending, *row) for ending, rows in WAITING.items() for row in rows]
)
def test_a_curve_that_waits_is_refused_by_name_wherever_it_is_read(ending, write, kind, tmp_path):
    path = tmp_path / f"curve.{ending.replace('_', '-')}"
    write(path, force_curve(AfmConfig(), 10e-9, 10e-9, 200))
    commands = [
        ["curve", "--overlay", str(path), "--out", str(tmp_path / "out")],
        ["calibrate", "sensitivity", "--curve", str(path)],
        *([["sample", "import", str(path), "--out", str(tmp_path / "map.npz")]] if path.suffix in MAP_SUFFIXES else []),
    ]
    for command in commands:
        said = invoke(command)
        assert said.exit_code == 2, said.output
        text = " ".join(said.output.split())
        assert f"{path.name}: " in text
        assert f"it holds curves of {kind}, taken over time at a constant force or place" in text

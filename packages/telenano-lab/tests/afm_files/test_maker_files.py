"""Files of several makers give the sizes, units and directions that were written, or a refusal with a way out."""

import json
import os
import stat
import zipfile
from pathlib import Path

import numpy as np
import pytest
from recorded_maps import frequency_shift_hz
from telenano_lab.afm_files import gwyddion
from telenano_lab.afm_files.map_files import MapOptions, import_map
from telenano_lab.calibration.own_calibration import spectrum_of
from telenano_lab.doubles.maker_files import (
    DOWN_N,
    HEIGHT_M,
    HEIGHTS,
    SENSITIVITY_M_PER_V,
    STIFFNESS_N_PER_M,
    UP_N,
    write_afm_workshop_map,
    write_jpk_hdf5,
    write_nanonis_dat,
    write_nanoscope,
    write_nhf,
    write_nid,
    write_nid_map,
    write_nsid,
)
from telenano_lab.microscopy.force_curve import Curve, read_measured
from telenano_lab.microscopy.image_files import Image, write_gwy

from telenano.sections import read_surface
from telenano.testing import invoke
from telenano.wire import ConfigError

CONSTANTS = {"stiffness_n_per_m": STIFFNESS_N_PER_M, "sensitivity_m_per_v": SENSITIVITY_M_PER_V}
needs_converter = pytest.mark.skipif(
    gwyddion.converter() is None, reason="Gwyddion's converter is not installed: pip install gwyddionpy-converter"
)


def is_the_curve(found: Curve, points: int = 200) -> None:
    """Assert the curve that was written: towards the sample first, pushed away with a force above 0, in its units."""
    assert (len(found.approach.base_m), found.stiffness_n_per_m) == (points, STIFFNESS_N_PER_M)
    assert found.approach.base_m[-1] - found.approach.base_m[0] == pytest.approx(
        HEIGHT_M[0] - HEIGHT_M[points - 1], rel=1e-4, abs=0
    )
    assert np.diff(found.approach.base_m).min() > 0.0 > np.diff(found.retract.base_m).max()
    far = float(np.median(DOWN_N[:20]))
    assert found.approach.force_n == pytest.approx(DOWN_N[:points] - far, rel=0, abs=1e-13)
    assert found.retract.force_n == pytest.approx(UP_N[:points][::-1] - far, rel=0, abs=1e-13)


def test_a_force_map_of_nanosurf_has_its_curves_in_their_places(tmp_path: Path) -> None:
    path = write_nid_map(tmp_path / "map.nid", 3, 2)
    is_the_curve(read_measured(path, 4))
    found = import_map(path, MapOptions({}, level="common")).map
    assert (found.values.shape[:3], found.stiffness_n_per_m) == ((2, 3, 2), STIFFNESS_N_PER_M)
    assert found.x_m == pytest.approx([-40e-9, 0.0, 40e-9], rel=1e-9, abs=1e-15)
    # a column is 1 nm deeper than the one before it, in the row that was measured from right to left as well
    low = found.z_m[np.argmin(found.values[1], axis=-1)]
    assert np.diff(low, axis=0) == pytest.approx(-1e-9, rel=0, abs=3e-10)
    with pytest.raises(ConfigError, match="has no image; `telenano curve --overlay` reads its curves"):
        read_surface(path)


def test_an_image_of_nanosurf_is_read_without_another_program(tmp_path: Path) -> None:
    facts = {"Frame": "Scan forward", "Dim0Unit": "m", "Dim0Range": 160e-9, "Dim1Range": 100e-9}
    volts = ({**facts, "Dim2Name": "Deflection", "Dim2Unit": "V"}, 1e9 * HEIGHTS)
    path = write_nid(tmp_path / "a.nid", [volts, ({**facts, "Dim2Name": "Z-Axis", "Dim2Unit": "m"}, HEIGHTS)])
    surface = read_surface(path)
    assert surface.height_m == pytest.approx(HEIGHTS, rel=0, abs=1e-16)
    assert (surface.width_m, surface.depth_m) == pytest.approx((160e-9, 100e-9), rel=1e-9)
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(
        ConfigError, match="is not a complete file of Nanosurf: it has 1276 bytes of data, its header states 1280"
    ):
        read_surface(path)


def test_a_thermal_spectrum_has_the_unit_of_its_maker(tmp_path: Path) -> None:
    frequency, density = np.linspace(0.0, 3e5, 400), 1e-13 * (1.0 + np.arange(400.0) / 400.0)
    facts = {"Frame": "Spectrum FFT", "Dim0Min": 0, "Dim0Range": 3e5, "Dim2Name": "ASD", "Dim2Unit": "m/sqrt(Hz)"}
    found = spectrum_of(write_nid(tmp_path / "a.nid", [(facts, density[None])], **{"DataSet-Info": "Averages=250"}))
    assert (found.is_of_metres, found.averages) == (True, 250.0)
    assert found.frequency_hz == pytest.approx(frequency, rel=1e-12)
    assert found.density_per_hz == pytest.approx(density**2, rel=1e-6, abs=0)
    head = "# thermal noise data\n# parameter.A: 92.12 µV/√Hz\n# Channels: 'Frequency' 'Deflection' 'average' 'fit'\n"
    rows = "\n".join(f"{f} {9.0 * d} {d} 0.0" for f, d in zip(frequency, density, strict=True))
    (tmp_path / "a.tnd").write_text(head + "# Units: 'Hz' 'V²/Hz' 'V²/Hz' 'V²/Hz'\n\n" + rows, encoding="utf-8")
    found = spectrum_of(tmp_path / "a.tnd")
    assert not found.is_of_metres and found.density_per_hz == pytest.approx(density, rel=1e-12)
    said = invoke(["calibrate", "stiffness", "--spectrum", str(tmp_path / "a.tnd"), "--json"])
    assert said.exit_code == 2 and "--sensitivity: a measurement in volts" in said.output
    with pytest.raises(ConfigError, match=r"map\.nid: has no thermal spectrum; it has Spec backward, Spec forward"):
        spectrum_of(write_nid_map(tmp_path / "map.nid", 2, 1))


def test_nanosurf_in_hdf5_gives_images_and_curves_of_several_lengths(tmp_path: Path) -> None:
    path = write_nhf(tmp_path / "a.nhf")
    surface = read_surface(path)
    assert surface.height_m == pytest.approx(HEIGHTS, rel=0, abs=1e-16)
    assert (surface.width_m, surface.depth_m) == pytest.approx((160e-9, 100e-9), rel=1e-9)
    is_the_curve(read_measured(path))
    is_the_curve(read_measured(path, 5), 190)
    found = import_map(path, MapOptions({})).map
    assert (found.values.shape[:3], found.x_m[1] - found.x_m[0]) == ((2, 3, 2), pytest.approx(4e-8 / 3))


def test_a_spectroscopy_of_nanonis_is_a_curve_of_force_or_a_map_of_its_shift(tmp_path: Path) -> None:
    z = 1e-8 + HEIGHT_M
    columns = {"Z rel (m)": z, "Current (A)": 0.0 * z,
               "Deflection (V)": DOWN_N / 0.1, "Deflection [bwd] (V)": UP_N / 0.1,
               "Deflection [filt] (V)": np.nan * z}  # fmt: skip
    path = write_nanonis_dat(tmp_path / "force.dat", columns)
    with pytest.raises(
        ConfigError, match="stiffness_n_per_m, sensitivity_m_per_v: the file has no such value; give --set"
    ):
        read_measured(path)
    is_the_curve(read_measured(path, 0, {"stiffness_n_per_m": 2.0, "sensitivity_m_per_v": 0.05}))
    # away from the sample the way back is the approach
    away = {name: row[::-1] for name, row in columns.items()}
    away["Deflection (V)"], away["Deflection [bwd] (V)"] = away["Deflection [bwd] (V)"], away["Deflection (V)"]
    path = write_nanonis_dat(tmp_path / "away.dat", away)
    is_the_curve(read_measured(path, 0, {"stiffness_n_per_m": 2.0, "sensitivity_m_per_v": 0.05}))
    z = np.linspace(2e-9, 0.0, 64)
    shift = frequency_shift_hz(z)
    lost = np.where(np.arange(64) < 60, shift, np.nan)
    path = write_nanonis_dat(
        tmp_path / "shift.dat", {"Z rel (m)": z, "Frequency Shift (Hz)": shift, "Frequency Shift [bwd] (Hz)": lost}
    )
    found = import_map(path, MapOptions({}))
    assert (found.map.quantity, found.map.values.shape[:3]) == ("frequency_shift", (2, 1, 1))
    assert found.notes[0] == "4 values are no number, where curves were cut short; the others are taken"
    assert found.map.values[0, 0, 0].min() == pytest.approx(shift[:60].min(), rel=1e-2)
    with pytest.raises(
        ConfigError, match="a frequency shift becomes a force by `telenano sample import FILE --as force`"
    ):
        read_measured(path)
    path = write_nanonis_dat(tmp_path / "bias.dat", {"Bias calc (V)": z, "Current (A)": z}, "bias spectroscopy")
    for read in (read_measured, lambda path: import_map(path, MapOptions({}))):
        with pytest.raises(
            ConfigError, match=r"a spectroscopy over Bias calc \(V\); a curve of force or frequency shift"
        ):
            read(path)


def test_a_map_of_afm_workshop_asks_for_its_constants_and_takes_them(tmp_path: Path) -> None:
    path = write_afm_workshop_map(tmp_path / "map.zip", 3, 2)
    with pytest.raises(ConfigError, match="stiffness_n_per_m, sensitivity_m_per_v: the file has no such value"):
        import_map(path, MapOptions({}))
    is_the_curve(read_measured(path, 3, CONSTANTS))
    found = import_map(path, MapOptions(CONSTANTS)).map
    assert (found.values.shape[:3], found.stiffness_n_per_m) == ((2, 3, 2), STIFFNESS_N_PER_M)
    assert np.diff(found.x_m) == pytest.approx(40e-9, rel=1e-6)


def test_a_folder_of_waves_is_a_map_of_asylum(tmp_path: Path) -> None:
    from telenano_lab.doubles.maker_files import wave

    note = "SpringConstant:2.0\rInvOLS:5e-8\rFastScanSize:1.2e-07\rSlowScanSize:4e-08\rIndexes:0,199,210,410"
    for i in range(3):
        for j in range(2):
            base = 3e-6 - np.concatenate([HEIGHT_M, HEIGHT_M[-1:].repeat(11), HEIGHT_M[::-1]])
            force = np.concatenate([DOWN_N, DOWN_N[-1:].repeat(11), UP_N[::-1]])
            columns = np.stack([base, force / 2.0, base], axis=1)
            content = wave(columns, labels=((1, "Raw"), (1, "Defl"), (1, "ZSnsr")), note=note)
            (tmp_path / f"Line{j:04}Point{i:04}.ibw").write_bytes(content)
    found = import_map(tmp_path, MapOptions({})).map
    assert (found.values.shape[:3], found.stiffness_n_per_m) == ((2, 3, 2), 2.0)
    assert (np.diff(found.x_m), np.diff(found.y_m)) == (pytest.approx(40e-9), pytest.approx(20e-9))
    # the pause at the sample is part of no way
    assert found.values[0, 2, 1] == pytest.approx(np.interp(found.z_m, HEIGHT_M[::-1], DOWN_N[::-1]), abs=2e-11)
    (tmp_path / "other").mkdir()
    with pytest.raises(ConfigError, match="a folder without the waves of a map, which are named as Line0003Point0012"):
        import_map(tmp_path / "other", MapOptions({}))


def test_a_force_curve_of_bruker_is_read_by_what_is_in_the_file(tmp_path: Path) -> None:
    found = read_measured(write_nanoscope(tmp_path / "curve.001"))
    assert (len(found.approach.base_m), found.stiffness_n_per_m) == (200, STIFFNESS_N_PER_M)
    assert np.diff(found.approach.base_m) == pytest.approx(20e-9 / 199, rel=1e-6)
    # a step of 0.1 mV is 10 pN
    far = float(np.median(DOWN_N[:20]))
    assert found.approach.force_n == pytest.approx(DOWN_N - far, rel=0, abs=1.1e-11)
    assert found.retract.force_n == pytest.approx(UP_N[::-1] - far, rel=0, abs=1.1e-11)
    volume = import_map(write_nanoscope(tmp_path / "volume.spm", 3), MapOptions({})).map
    assert (volume.values.shape[:3], volume.stiffness_n_per_m) == ((2, 3, 3), STIFFNESS_N_PER_M)
    assert np.diff(volume.x_m) == pytest.approx(40e-9, rel=1e-9)
    for changes, words in (
        ({"factor": 20_000}, "beyond the 16 bits of its converter"),
        ({"capture": "Allow"}, "whose piezo follows a sine"),
        ({"points": 100}, "is not a complete file of NanoScope: 1 x 1 curves of 100 and 200 samples"),
    ):
        with pytest.raises(ConfigError, match=words):
            read_measured(write_nanoscope(tmp_path / "other.spm", **changes))
    (tmp_path / "other.spm").write_text("no curve")
    with pytest.raises(ConfigError, match=r"of no format of force curves that is known here; these are \.csv"):
        read_measured(tmp_path / "other.spm")


def test_what_has_the_ending_and_no_curves_is_refused_with_a_way_out_and_not_in_the_words_of_a_library(
    tmp_path: Path,
) -> None:
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        archive.writestr("table.csv", "1,2\n")
    for path in (tmp_path / "other.zip", write_nsid(tmp_path / "image.h5")):
        for read in (read_measured, lambda path: import_map(path, MapOptions({}))):
            with pytest.raises(ConfigError, match=r"holds no force curves .*docs/fit\.md \(My file\)") as caught:
                read(path)
            assert "Could not" not in str(caught.value)


def test_images_of_jpk_and_nsid_in_hdf5_have_their_size_and_unit(tmp_path: Path) -> None:
    for path in (write_jpk_hdf5(tmp_path / "a.h5-jpk"), write_nsid(tmp_path / "a.h5")):
        surface = read_surface(path)
        assert surface.height_m == pytest.approx(HEIGHTS, rel=0, abs=1e-13)
        assert (surface.width_m, surface.depth_m) == pytest.approx((160e-9, 100e-9), rel=1e-9)
    second = read_surface(tmp_path / "a.h5-jpk", "height 2 of 2")
    assert second.height_m == pytest.approx(2.0 * HEIGHTS, rel=0, abs=2e-13)
    with pytest.raises(ConfigError, match=r"the heights of channel Height is 'a\.u\.'; it must be a length"):
        read_surface(write_nsid(tmp_path / "b.hf5", "a.u."))
    import h5py

    with h5py.File(tmp_path / "c.h5", "w") as file:
        file["some/data"] = HEIGHTS
    with pytest.raises(
        ConfigError, match=r"it has /some/data\. Export the image as \.gsf or \.gwy, or as \.npy with `--size`"
    ):
        read_surface(tmp_path / "c.h5")


def test_a_curve_takes_the_constants_that_its_file_lacks(tmp_path: Path) -> None:
    path = write_afm_workshop_map(tmp_path / "map.zip", 2, 2)
    call = ["curve", "--out", str(tmp_path / "out"), "--points", "40", "--overlay", str(path), "--json"]
    said = invoke([*call, "--set", f"stiffness_n_per_m={STIFFNESS_N_PER_M}",
                                    "--set", f"sensitivity_m_per_v={SENSITIVITY_M_PER_V}"])  # fmt: skip
    assert said.exit_code == 0, said.output
    measured = json.loads(said.stdout)["measured"]
    assert measured["stiffness_n_per_m"] == STIFFNESS_N_PER_M
    far = float(np.median(DOWN_N[:20]))
    assert measured["pull_off_force_n"] == pytest.approx(float(UP_N.min()) - far, rel=1e-3, abs=0)
    for key, words in (
        ("stiffness=2", "is not a constant of a curve"),
        ("stiffness_n_per_m=-2", "must be a number above 0"),
    ):
        said = invoke([*call, "--set", key])
        assert said.exit_code == 2 and words in said.output


def test_without_the_converter_of_gwyddion_a_refusal_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gwyddion, "converter", lambda: None)
    with pytest.raises(
        ValueError, match=r"read by Gwyddion's converter: pip install gwyddionpy-converter .*GPL.*as \.gwy"
    ):
        gwyddion.load_image(str(tmp_path / "a.spm"))


def test_what_gwyddion_fills_in_is_told_from_what_was_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The program that stands for the converter writes a map whose mask has three points."""
    from gwyfile.objects import GwyContainer, GwyDataField, GwySIUnit

    unit, masked = GwySIUnit(unitstr="m"), np.zeros(HEIGHTS.shape)
    masked[0, :3] = 1.0
    fields = [GwyDataField(values, xreal=160e-9, yreal=100e-9, si_unit_xy=unit, si_unit_z=unit)
              for values in (np.ascontiguousarray(HEIGHTS[::-1]), masked)]  # fmt: skip
    written = {"/0/data": fields[0], "/0/data/title": "Height", "/0/mask": fields[1]}
    GwyContainer(written).tofile(str(tmp_path / "made.gwy"))
    program = tmp_path / "bin" / "gwyconvert"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\ncp {tmp_path}/made.gwy "$2"\n')
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    (tmp_path / "a.opd").write_bytes(b"heights that the converter reads")
    surface = read_surface(tmp_path / "a.opd", may_lack=True)
    assert np.argwhere(np.isnan(surface.height_m)).tolist() == [[9, 0], [9, 1], [9, 2]]
    # in a file of Gwyddion itself a mask is what its user marked
    assert np.array_equal(read_surface(tmp_path / "made.gwy").height_m, HEIGHTS)
    program.write_text(
        "#!/bin/sh\necho \"gwyconvert: cannot load '$1': No module can load this file type.\" >&2\nexit 1\n"
    )
    with pytest.raises(ConfigError, match=r"a\.opd: is of no format that Gwyddion knows; export it as \.gsf"):
        read_surface(tmp_path / "a.opd")
    program.write_text("#!/bin/sh\necho \"gwyconvert: cannot load '$1': File is truncated.\" >&2\nexit 1\n")
    with pytest.raises(ConfigError, match=r"a\.opd: Gwyddion's converter cannot read it: File is truncated\."):
        read_surface(tmp_path / "a.opd")


@needs_converter
def test_the_converter_gives_the_same_heights_as_our_readers(tmp_path: Path) -> None:
    write_gwy(tmp_path / "a.gwy", {"height": Image("Height", "m", HEIGHTS, 160e-9, 100e-9)})
    (tmp_path / "a.foreign").write_bytes((tmp_path / "a.gwy").read_bytes())
    facts = {"Frame": "Scan forward", "Dim0Unit": "m", "Dim0Range": 160e-9, "Dim0Min": 0, "Dim1Unit": "m",
             "Dim1Range": 100e-9, "Dim1Min": 0, "Dim2Name": "Z-Axis", "Dim2Unit": "m"}  # fmt: skip
    write_nid(tmp_path / "a.nid", [(facts, HEIGHTS)])
    (tmp_path / "nid.foreign").write_bytes((tmp_path / "a.nid").read_bytes())
    for name in ("a.foreign", "nid.foreign"):
        surface = read_surface(tmp_path / name)
        assert surface.height_m == pytest.approx(HEIGHTS, rel=0, abs=1e-16), name
        assert (surface.width_m, surface.depth_m) == pytest.approx((160e-9, 100e-9), rel=1e-9), name


@needs_converter
def test_text_with_units_is_read_and_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    rows = "\n".join(" ".join(f"{1e9 * value:.6f}" for value in row) for row in HEIGHTS[::-1])
    head = "# Channel: Height\n# Width: 160 nm\n# Height: 100 nm\n# Value units: nm\n"
    (tmp_path / "a.txt").write_text(head + rows)
    assert read_surface(tmp_path / "a.txt").height_m == pytest.approx(HEIGHTS, abs=1e-15)
    (tmp_path / "c.txt").write_text("no image at all")
    with pytest.raises(ConfigError, match=r"c\.txt: is of no format that Gwyddion knows; export it as \.gsf"):
        read_surface(tmp_path / "c.txt")

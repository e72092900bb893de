"""All curves of files in one table: maps, folders, what is refused, and the same bits whatever the processor can."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from telenano_lab.afm_files.curve_table import UNITS, curves
from telenano_lab.doubles.made_curves import made_map, write_map

import telenano
from telenano.testing import invoke
from telenano.wire import ConfigError

DATA = Path(__file__).parents[5] / "shared" / "data" / "SiN_FD_plot.ibw"
RADIUS_M = 1e-6


@pytest.fixture(scope="module")
def hertz_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("map") / "map.h5"
    write_map(path, made_map("hertz", 4, 1))
    return path


@pytest.mark.check("fits a map of curves")
@pytest.mark.drawn(0.3, "packages/telenano-lab/telenano_lab/afm_files/")
def test_a_map_is_a_table_whose_rows_are_its_curves(hertz_map: Path) -> None:
    frame = telenano.curves(hertz_map, "hertz", radius_m=RADIUS_M)
    assert list(frame.columns) == list(UNITS) == list(frame.attrs["units"])
    assert len(frame) == 16
    assert len(set(zip(frame.x_m, frame.y_m, strict=True))) == 16
    made = {(i, j): each for i, column in enumerate(made_map("hertz", 4, 1)) for j, each in enumerate(column)}
    fitted = frame[frame.verdict == "fitted"]
    assert len(fitted) >= 14
    for row in fitted.itertuples():
        truth = made[int(row.x_m / 0.25e-6), int(row.y_m / 0.25e-6)].truth
        assert abs(row.modulus_pa - truth.modulus_pa) < 4.0 * row.modulus_error_pa
        assert abs(row.contact_m - truth.contact_m) < 4.0 * row.contact_error_m


@pytest.mark.check("fits a map of curves")
@pytest.mark.drawn(0.3, "packages/telenano-lab/telenano_lab/afm_files/")
def test_the_command_writes_the_table_of_the_function_and_two_pictures(hertz_map: Path, tmp_path: Path) -> None:
    out = tmp_path / "out" / "table.csv"
    words = ["curve", "fit", str(hertz_map), "--model", "hertz", "--radius", "1000", "--out", str(out), "--json"]
    result = invoke(words)
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    assert document["curves"] == document["fitted"] + document["refused"] == 16
    frame = curves(hertz_map, "hertz", radius_m=RADIUS_M)
    read = pd.read_csv(out)
    assert list(read.columns) == list(UNITS)
    # a reason that is empty is none in a file
    pd.testing.assert_frame_equal(read.drop(columns="reason"), frame.drop(columns="reason"), check_dtype=False, rtol=0)
    for name in ("table_map.png", "table_fits.png"):
        assert (out.parent / name).stat().st_size > 20_000


@pytest.mark.check("fits a map of curves")
@pytest.mark.drawn(0.3, "packages/telenano-lab/telenano_lab/afm_files/")
def test_a_grid_of_numpy_is_fitted_as_the_curves_that_it_was_made_of(tmp_path: Path) -> None:
    made = made_map("hertz", 2, 3)[0][0]
    z = made.approach_m
    value = np.stack([made.approach_n, np.interp(z, made.retract_m, made.retract_n)], axis=1)
    even = np.linspace(z[0], z[-1], len(z))
    np.savez(
        tmp_path / "grid.npz", value=np.array([[value, value]]), x=[0.0], y=[0.0, 1e-7], z=even,
        unit="N", length_unit="m", sign=1, axis="base", stiffness_n_per_m=made.stiffness_n_per_m,
    )  # fmt: skip
    frame = curves(tmp_path / "grid.npz", "hertz", radius_m=RADIUS_M)
    assert list(frame.verdict) == ["fitted"] * 2
    assert frame.modulus_pa[0] == frame.modulus_pa[1]
    assert abs(frame.modulus_pa[0] - made.truth.modulus_pa) < 4.0 * frame.modulus_error_pa[0]


@pytest.mark.check("fits a map of curves")
@pytest.mark.drawn(0.3, "packages/telenano-lab/telenano_lab/afm_files/")
def test_a_folder_is_all_its_files_and_one_that_cannot_be_read_is_a_row(hertz_map: Path, tmp_path: Path) -> None:
    shutil.copy(hertz_map, tmp_path / "a.h5")
    (tmp_path / "b.txt").write_text("no curve at all\n")
    (tmp_path / "notes.pdf").write_text("not looked at")
    frame = curves(tmp_path, "hertz", radius_m=RADIUS_M)
    assert len(frame) == 17
    last = frame.iloc[-1]
    assert (Path(last.file).name, last.verdict) == ("b.txt", "refused")
    assert last.reason


@pytest.mark.check("fits a map of curves")
def test_more_refused_than_may_be_ends_the_command_with_a_failure_and_keeps_the_table(
    hertz_map: Path, tmp_path: Path
) -> None:
    out = tmp_path / "table.csv"
    # retractions without a pull-off are no contact of JKR
    words = ["curve", "fit", str(hertz_map), "--model", "jkr", "--radius", "1000", "--out", str(out)]
    result = invoke([*words, "--most-refused", "0.1"])
    assert result.exit_code == 1
    assert "--most-refused 0.1" in result.stderr
    assert len(pd.read_csv(out)) == 16
    assert invoke([*words, "--most-refused", "1"]).exit_code == 0


@pytest.mark.check("reads a map in a child process")
@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["none.txt", "--model", "hertz", "--radius", "10"], "none.txt: cannot be read"),
        (["{map}", "--model", "hertz"], "--radius"),
        (["{map}", "--model", "sneddon"], "--half-angle"),
        (["{map}", "--model", "jkr", "--radius", "10", "--thickness", "5"], "take hertz or dmt"),
        (["{map}", "--model", "hertz", "--radius", "10", "--set", "stiffness_n_per_m=-1"], "stiffness_n_per_m"),
    ],
)
def test_what_is_missing_is_asked_for_by_its_name(
    words: list[str], reason: str, hertz_map: Path, tmp_path: Path
) -> None:
    given = [word.format(map=hertz_map) for word in words]
    result = invoke(["curve", "fit", *given, "--out", str(tmp_path / "table.csv")])
    assert result.exit_code != 0
    assert reason in result.stderr
    assert "Traceback" not in result.stderr
    assert not (tmp_path / "table.csv").exists()


def test_a_map_of_no_force_is_refused(tmp_path: Path) -> None:
    axis = np.linspace(0.0, 1e-8, 64)
    np.savez(tmp_path / "hz.npz", value=np.zeros((1, 1, 64)), x=[0.0], y=[0.0], z=axis, unit="Hz", length_unit="m")
    with pytest.raises(ConfigError, match="frequency shift, and no force"):
        curves(tmp_path / "hz.npz", "hertz", radius_m=RADIUS_M)


@pytest.mark.skipif(not DATA.exists(), reason="measured data are not beside the project: ../shared/data")
def test_a_measured_curve_that_snaps_in_is_refused_for_a_sphere_without_adhesion() -> None:
    frame = curves(DATA, "hertz", radius_m=70e-9)
    assert frame.verdict[0] == "refused"
    assert "take dmt or jkr" in frame.reason[0]


PROGRAM = """
import hashlib, sys
from telenano_lab.afm_files.curve_table import curves
text = "".join(curves(sys.argv[1], model, radius_m=1e-6, half_angle_rad=0.3).to_csv() for model in ("hertz", "sneddon"))
print(hashlib.sha256(text.encode()).hexdigest())
"""


@pytest.mark.check("compiles the steps for a processor that can less")
@pytest.mark.drawn(0.3, "packages/telenano-lab/telenano_lab/afm_files/")
def test_the_table_is_the_same_on_a_processor_that_can_less(hertz_map: Path, tmp_path: Path) -> None:
    less = {
        "OPENBLAS_CORETYPE": "Haswell",
        "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512CD AVX512_SKX AVX2 FMA3",
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
        "XDG_CACHE_HOME": str(tmp_path),
    }
    digests = []
    for more in ({}, less):
        words = [sys.executable, "-W", "ignore", "-c", PROGRAM, str(hertz_map)]
        done = subprocess.run(words, env={**os.environ, **more}, capture_output=True, text=True, check=True)
        digests.append(done.stdout.strip())
    assert len(digests[0]) == len(hashlib.sha256().hexdigest())
    assert digests[0] == digests[1]

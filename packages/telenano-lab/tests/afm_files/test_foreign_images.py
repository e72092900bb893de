"""Images of other makers: the libraries read them in a child, the right way up, and what they cannot is a sentence."""

from pathlib import Path

import numpy as np
import pytest
from telenano_lab.microscopy.image_files import Image, write_gwy

from telenano.sections import read_surface
from telenano.wire import ConfigError

DATA = Path(__file__).parents[5] / "shared" / "data" / "spot_1-1000nm.ibw"
HEIGHTS = np.add.outer(np.linspace(0.0, 9e-9, 10), np.linspace(0.0, 4e-9, 16) ** 2 / 4e-9)


def sxm(path: Path, direction: str, *, whole: bool = True) -> Path:
    """Write a Nanonis image of 16 x 10 points over 160 x 100 nm, with the channel Z forward and backward."""
    lines = {
        "NANONIS_VERSION": "2",
        "SCANIT_TYPE": "              FLOAT            MSBFIRST",
        "REC_DATE": " 01.01.2026",
        "REC_TIME": "12:00:00",
        "REC_TEMP": "      290.0",
        "ACQ_TIME": "      10.0",
        "SCAN_PIXELS": "       16       10",
        "SCAN_FILE": "a.sxm",
        "SCAN_TIME": "             1.0E+0             1.0E+0",
        "SCAN_RANGE": "           1.6E-7           1.0E-7",
        "SCAN_OFFSET": "             0.0E+0         0.0E+0",
        "SCAN_ANGLE": "            0.0E+0",
        "SCAN_DIR": direction,
        "BIAS": "            0.0E+0",
        "DATA_INFO": "\tChannel\tName\tUnit\tDirection\tCalibration\tOffset\n\t14\tZ\tm\tboth\t1.0E-9\t0.0E+0\n",
    }
    head = "".join(f":{key}:\n{value}\n" for key, value in lines.items()) + ":SCANIT_END:\n\n"
    rows = HEIGHTS[::-1] if direction == "down" else HEIGHTS
    forward = rows.copy() if whole else np.where(np.arange(10)[:, None] < 7, rows, np.nan)
    data = np.stack([forward, forward[:, ::-1]]).astype(">f4")
    path.write_bytes(head.encode() + b"\n\x1a\x04" + data.tobytes())
    return path


@pytest.mark.parametrize("direction", ["up", "down"])
def test_a_nanonis_image_has_its_rows_from_below(tmp_path: Path, direction: str) -> None:
    surface = read_surface(sxm(tmp_path / "a.sxm", direction))
    assert surface.height_m == pytest.approx(HEIGHTS, abs=1e-15)
    assert (surface.width_m, surface.depth_m) == pytest.approx((160e-9, 100e-9), rel=1e-6)


@pytest.mark.parametrize("direction", ["up", "down"])
def test_an_image_that_was_stopped_has_its_finished_lines(tmp_path: Path, direction: str) -> None:
    whole = read_surface(sxm(tmp_path / "whole.sxm", direction))
    found = read_surface(sxm(tmp_path / "a.sxm", direction, whole=False))
    lines = len(found.height_m)
    assert 0 < lines < len(whole.height_m)
    assert np.isfinite(found.height_m).all()
    assert (found.width_m, found.depth_m / lines) == pytest.approx((whole.width_m, whole.depth_m / len(whole.height_m)))
    kept = whole.height_m[:lines] if direction == "up" else whole.height_m[-lines:]
    np.testing.assert_array_equal(found.height_m, kept)


IMAGE = Image("Height", "m", HEIGHTS, 160e-9, 100e-9)


def test_a_channel_of_a_gwyddion_file_is_found_by_its_height_or_name(tmp_path: Path) -> None:
    path = tmp_path / "map.gwy"
    phase = IMAGE._replace(title="Phase", unit="deg", values=HEIGHTS * 1e9)
    other = IMAGE._replace(title="Retrace Height", values=2 * HEIGHTS)
    write_gwy(path, {"phase": phase, "height": IMAGE, "other": other})
    assert np.array_equal(read_surface(path).height_m, HEIGHTS)
    assert np.array_equal(read_surface(path, "retrace").height_m, 2 * HEIGHTS)
    with pytest.raises(ConfigError, match="the unit of the heights of channel Phase is 'deg'"):
        read_surface(path, "phase")
    with pytest.raises(ConfigError, match="has no channel 'current'; it has: Phase, Height, Retrace Height"):
        read_surface(path, "current")


def test_a_gwyddion_file_that_was_cut_gives_neither_a_traceback_nor_a_map(tmp_path: Path) -> None:
    path = tmp_path / "map.gwy"
    write_gwy(path, {"height": IMAGE})
    whole = path.read_bytes()
    for length in (0, 5, 30, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(ConfigError, match=r"map\.gwy: is (not a (complete )?Gwyddion file|empty)"):
            read_surface(path)


@pytest.mark.skipif(not DATA.exists(), reason="measured data are not beside the project: ../shared/data")
def test_a_measured_topography_is_read_in_metres() -> None:
    surface = read_surface(DATA)
    assert surface.height_m.shape == (256, 256)
    # 20 um over 255 intervals, 256 pixels
    assert surface.width_m == pytest.approx(20e-6 * 256 / 255, rel=1e-6, abs=0)
    assert surface.height_m.std() == pytest.approx(89.45e-9, rel=1e-3, abs=0)
    with pytest.raises(ConfigError, match="PhaseTrace is 'deg'"):
        read_surface(DATA, "phase")

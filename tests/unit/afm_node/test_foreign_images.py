"""Images of other makers: the libraries read them in a child, the right way up, and what they cannot is a sentence."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.image_files import Image, write_gwy
from proto.errors import ConfigError
from services.afm_node.physics.sample import surface_files
from services.afm_node.physics.sample.surface_files import read_surface

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


def test_an_image_that_was_stopped_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"a\.sxm: its map Z was not scanned to its end"):
        read_surface(sxm(tmp_path / "a.sxm", "up", whole=False))


def test_without_the_library_the_way_out_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def lacking(*arguments: Any, **options: Any) -> Any:
        raise ImportError(name="SurfaceTopography")

    monkeypatch.setattr(surface_files, "read_in_child", lacking)
    (tmp_path / "map.spm").touch()
    with pytest.raises(ConfigError, match=r"need SurfaceTopography: pip install .*\[images\].*without it \.gsf, \.gwy"):
        read_surface(tmp_path / "map.spm")


@pytest.mark.endurance
def test_what_surface_topography_reads_is_the_right_way_up_and_of_the_right_size(tmp_path: Path) -> None:
    write_gwy(tmp_path / "a.gwy", {"height": Image("Height", "m", HEIGHTS, 160e-9, 100e-9)})
    shutil.copy(tmp_path / "a.gwy", tmp_path / "a.foreign")
    own, foreign = read_surface(tmp_path / "a.gwy"), read_surface(tmp_path / "a.foreign")
    assert foreign.height_m == pytest.approx(own.height_m, abs=1e-18)
    assert (foreign.width_m, foreign.depth_m) == pytest.approx((own.width_m, own.depth_m), rel=1e-9)


@pytest.mark.endurance
def test_text_with_units_is_read_and_what_has_none_is_refused(tmp_path: Path) -> None:
    rows = "\n".join(" ".join(f"{1e9 * value:.6f}" for value in row) for row in HEIGHTS[::-1])
    head = "# Channel: Height\n# Width: 160 nm\n# Height: 100 nm\n# Value units: nm\n"
    (tmp_path / "a.txt").write_text(head + rows)
    assert read_surface(tmp_path / "a.txt").height_m == pytest.approx(HEIGHTS, abs=1e-15)
    (tmp_path / "b.txt").write_text(rows)
    with pytest.raises(ConfigError, match=r"b\.txt: has no map whose heights and sides have a unit of length"):
        read_surface(tmp_path / "b.txt")
    (tmp_path / "c.txt").write_text("no image at all")
    with pytest.raises(ConfigError, match=r"c\.txt: is of no format that is known here; Gwyddion may open it"):
        read_surface(tmp_path / "c.txt")

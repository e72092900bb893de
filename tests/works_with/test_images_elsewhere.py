"""Images in programs of microscopists: size, unit, heights and which way up they are."""

import json
from pathlib import Path

import numpy as np
import pytest
from foreign_programs import Program, debian_program, python_program
from gwyddion_files import read_gwy
from matplotlib.image import imread
from planted_errors import Numbers, each_error, judge, planted
from telenano_lab.microscopy.image_files import Image, write_gsf, write_gwy

pytestmark = pytest.mark.timeout(1800)

# Wider than deep, different along both axes, of both signs and with no symmetry.
ROWS, COLUMNS = 24, 40
ALONG, UP = np.meshgrid(np.linspace(0.0, 1.0, COLUMNS), np.linspace(0.0, 1.0, ROWS))
HEIGHT_M = 1e-9 * (3.0 * UP**2 + ALONG - 1.5 + 0.3 * np.sin(9.0 * ALONG * UP))
WIDTH_M, DEPTH_M = 400e-9, 240e-9
# A Gwyddion Simple Field holds 32-bit floats.
OF_FLOAT32 = 1e-7

AFM_READER = """
import json, sys
from AFMReader.gwy import load_gwy
heights_nm, nm_per_pixel = load_gwy(sys.argv[1], "Height")
print(json.dumps({"height": (1e-9 * heights_nm).tolist(), "pixel": 1e-9 * nm_per_pixel}))
"""


def image_of(heights_m: np.ndarray) -> Image:
    """Return an image whose rows have rising y, as everywhere in telenano."""
    rows, columns = heights_m.shape
    return Image("Height", "m", heights_m, WIDTH_M * columns / COLUMNS, DEPTH_M * rows / ROWS)


@pytest.fixture
def gwyddion(tmp_path: Path) -> Program:
    program = debian_program("usr/bin/gwyddion", "gwyddion")
    libraries = next(program.folder.glob("usr/lib/*/gwyddion")).parent
    (tmp_path / ".gwyddion").mkdir()
    return program.having(GWYDDION_LIBDIR=libraries, GWYDDION_DATADIR=program.folder / "usr/share", HOME=tmp_path)


def written(folder: Path, form: str, error: str) -> Path:
    path, image = folder / f"image.{form}", image_of(planted(error, HEIGHT_M, axis=0, unit=1e9))
    if form == "gsf":
        write_gsf(path, image)
    else:
        write_gwy(path, {"height": image, "retrace": image._replace(title="Height retrace", values=2.0 * image.values)})
    return path


def seen_by_gwyddion(gwyddion: Program, path: Path) -> Numbers:
    """Return what Gwyddion says of a file: the fields that it converts, and the picture that it shows of the first."""
    opened, picture = path.with_suffix(".opened.gwy"), path.with_suffix(".png")
    gwyddion.run(f"--convert-to-gwy={opened}", path)
    thumbnailer = gwyddion._replace(command=(f"{gwyddion.command[0]}-thumbnailer",))
    thumbnailer.run("gnome2", "128", path, picture)
    # The palette is grey and goes from the lowest to the highest place of the image.
    grey = imread(picture)[:, :, 0]
    found = {"picture": (grey - grey.min()) / (grey.max() - grey.min())}
    entries = read_gwy(opened)
    for number in (0, 1):
        if field := entries.get(f"/{number}/data"):
            assert (field["si_unit_xy"]["unitstr"], field["si_unit_z"]["unitstr"]) == ("m", "m")
            title = entries[f"/{number}/data/title"]
            found[title] = field["data"].reshape(field["yres"], field["xres"])
            found[f"{title} sides"] = (field["xreal"], field["yreal"])
    return found


@pytest.mark.parametrize("form", ["gwy", "gsf"])
@each_error
@pytest.mark.check("installs Gwyddion")
def test_gwyddion_shows_an_image(gwyddion: Program, tmp_path: Path, form: str, error: str) -> None:
    # The first row of a file of Gwyddion is the top of the picture.
    top_first = HEIGHT_M[::-1]
    wanted: Numbers = {"Height": top_first, "Height sides": (WIDTH_M, DEPTH_M)}
    if form == "gwy":
        wanted = {**wanted, "Height retrace": 2.0 * top_first, "Height retrace sides": (WIDTH_M, DEPTH_M)}
    found = seen_by_gwyddion(gwyddion, written(tmp_path, form, error))
    judge(error, wanted, found, rtol=OF_FLOAT32 if form == "gsf" else 0.0)
    if error != "unit":
        # A grey scale has no unit.
        shown = (top_first - top_first.min()) / np.ptp(top_first)
        judge(error, {"picture": shown}, found, rtol=0.01)


@each_error
@pytest.mark.endurance
def test_afmreader_reads_a_square_image(tmp_path: Path, error: str) -> None:
    reader = python_program("AFMReader==0.0.7")
    square = HEIGHT_M[:, :ROWS]
    write_gwy(tmp_path / "image.gwy", {"height": image_of(planted(error, square, axis=0, unit=1e9))})
    found = json.loads(reader.run("-c", AFM_READER, tmp_path / "image.gwy"))
    judge(error, {"height": square[::-1], "pixel": DEPTH_M / ROWS}, found, rtol=1e-9)

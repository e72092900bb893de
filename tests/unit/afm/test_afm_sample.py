"""Samples from files and functions: what is read is what was written, and what is wrong is named."""

import numpy as np
import pytest
from telenano_lab.microscopy.image_files import Image, write_gsf, write_gwy

from telenano.sections.sample_section import SampleConfig
from telenano.sections.surface_files import read_surface
from telenano.wire.errors import ConfigError

HEIGHTS = np.random.default_rng(5).normal(0.0, 3e-9, (7, 11)).astype(np.float32).astype(float)
IMAGE = Image("Height", "m", HEIGHTS, 110e-9, 35e-9)


def waves(x_m, y_m):
    return 2e-9 * np.sin(x_m / 10e-9) + 0.0 * y_m


def broken(x_m, y_m):
    raise ZeroDivisionError


@pytest.fixture
def gsf(tmp_path):
    write_gsf(tmp_path / "map.gsf", IMAGE)
    return tmp_path / "map.gsf"


def damaged(path, old, new):
    content = path.read_bytes()
    assert old in content
    # the header is padded to a multiple of four
    header, data = content.replace(old, new, 1).split(b"\0", 1)
    path.write_bytes(header + b"\0" * (4 - len(header) % 4) + data.lstrip(b"\0"))
    return path


def test_a_simple_field_comes_back_as_it_was_written(gsf):
    surface = read_surface(gsf)
    assert np.array_equal(surface.height_m, HEIGHTS)
    assert (surface.width_m, surface.depth_m) == pytest.approx((110e-9, 35e-9), rel=1e-12, abs=0)


@pytest.mark.parametrize(
    "write",
    [
        lambda folder, image: write_gsf(folder / "a.gsf", image),
        lambda folder, image: write_gwy(folder / "a.gwy", {"height": image}),
        lambda folder, image: np.save(folder / "a.npy", image.values[::-1]),
        lambda folder, image: np.savetxt(folder / "a.txt", image.values[::-1]),
        lambda folder, image: np.savetxt(folder / "a.csv", image.values[::-1], delimiter=","),
    ],
    ids=["gsf", "gwy", "npy", "txt", "csv"],
)
def test_the_first_row_of_a_file_is_the_top_of_the_picture_and_y_rises_with_the_row_of_a_surface(tmp_path, write):
    heights = HEIGHTS[:, :7]
    write(tmp_path, Image("Height", "m", heights, 70e-9, 70e-9))
    (path,) = tmp_path.iterdir()
    surface = read_surface(path, size_m=None if path.suffix in (".gsf", ".gwy") else 70e-9)
    assert np.array_equal(surface.height_m, heights)


def test_a_file_in_nanometres_is_converted(tmp_path):
    write_gsf(tmp_path / "nm.gsf", IMAGE._replace(unit="nm", values=HEIGHTS * 1e9))
    assert np.allclose(read_surface(tmp_path / "nm.gsf").height_m, HEIGHTS, rtol=1e-6, atol=0)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        (b"Gwyddion Simple", b"Gwyddion Sample", "is not a Gwyddion Simple Field"),
        (b"ZUnits = m", b"ZUnits = V", "the unit of the heights of channel Height is 'V'; it must be a length"),
        (b"XYUnits = m\n", b"", "the unit of the sides of channel Height is none"),
        (b"XRes = 11", b"XRes = 12", "has 308 bytes of heights; 12 x 7 values of 4 bytes need 336"),
        (b"XRes = 11", b"XRes = -1", "XRes is -1; it must be a whole number"),
        (b"YRes = 7\n", b"", "YRes is missing"),
        (b"XReal = 1.1e-07", b"XReal = nan", "XReal is nan"),
        (b"Title = Height", b"Title", "has the line 'Title'"),
    ],
)
def test_a_wrong_simple_field_is_named_with_what_is_wrong(gsf, old, new, what):
    with pytest.raises(ConfigError, match=what) as error:
        read_surface(damaged(gsf, old, new))
    assert str(error.value).startswith(f"{gsf}: ")


def test_no_truncation_gives_a_traceback_or_a_map(tmp_path, gsf):
    np.save(tmp_path / "map.npy", HEIGHTS[:, :7])
    for path in (gsf, tmp_path / "map.npy"):
        whole = path.read_bytes()
        size_m = 1e-7 if path.suffix == ".npy" else None
        for length in (0, 5, 30, len(whole) // 2, len(whole) - 1):
            path.write_bytes(whole[:length])
            with pytest.raises(ConfigError, match=str(path)):
                read_surface(path, size_m=size_m)


def test_an_array_needs_its_side_and_must_be_square_finite_and_of_numbers(tmp_path):
    path = tmp_path / "map.npy"
    np.save(path, HEIGHTS[:, :7])
    assert read_surface(path, size_m=70e-9).width_m == pytest.approx(70e-9, rel=1e-12, abs=0)
    with pytest.raises(ConfigError, match="give the side of the map"):
        read_surface(path)
    for values, what in (
        (HEIGHTS, "must be square"),
        (np.full((3, 3), np.inf), "9 heights that are not finite"),
        (np.array([["a"]]), "no array of numbers"),
        (np.array([[None]]), "no array of numbers"),
        (HEIGHTS[:, :7] * 1e9, "is its unit of height right"),
    ):
        np.save(path, values)
        with pytest.raises(ConfigError, match=what):
            read_surface(path, size_m=70e-9)


def test_a_matrix_of_heights_without_a_head_is_a_sample_with_its_size(tmp_path):
    path = tmp_path / "heights.txt"
    np.savetxt(path, HEIGHTS)
    section = SampleConfig(name=str(path), size_m=70e-9)
    assert section.build().width_m == pytest.approx(70e-9, rel=1e-12)
    with pytest.raises(ConfigError, match="give its width"):
        SampleConfig(name=str(path)).build()


def test_files_of_other_kinds_and_sizes_that_contradict_are_refused(gsf, tmp_path):
    with pytest.raises(ConfigError, match="states its size itself"):
        read_surface(gsf, size_m=1e-7)
    with pytest.raises(ConfigError, match="cannot be read: No such file"):
        read_surface(tmp_path / "none.ibw")


def test_a_sample_of_ones_own_is_a_function_of_x_and_y(monkeypatch):
    monkeypatch.setenv("TELENANO_ALLOW_CODE", "1")
    surface = SampleConfig(name=f"{__name__}:waves", size_m=1e-7, pixels=50).build()
    assert surface.height_m[3, 10] == pytest.approx(2e-9 * np.sin(10.5 * 2e-9 / 10e-9), rel=1e-12, abs=0)
    for name, what in (
        (f"{__name__}:missing", "has no such function"),
        ("no_such_module:f", "has no such function"),
        (f"{__name__}:broken", "failed for arrays of x and y in m: ZeroDivisionError"),
    ):
        with pytest.raises(ConfigError, match=what):
            SampleConfig(name=name, pixels=8).build()


@pytest.mark.parametrize("separator", ["\t", ";", ",", " "])
@pytest.mark.parametrize("unit", ["", "nm", "µm", "m"])
def test_a_matrix_of_heights_in_text_has_its_size_and_unit_from_head_or_option(tmp_path, separator, unit):
    draw = np.random.default_rng(3)
    heights = draw.uniform(-5e-9, 5e-9, (6, 9))
    scale = {"": 1.0, "m": 1.0, "nm": 1e-9, "µm": 1e-6}[unit]
    # rows run from the top down, and y rises
    text = "\n".join(separator.join(f"{v / scale:.9e}" for v in row) for row in heights[::-1]) + "\n"
    text = text.replace(".", ",") if separator == ";" else text
    said = f"# Channel: Topography\n# Value units: {unit}\n" if unit else ""
    path = tmp_path / "m.txt"
    path.write_text(said + text, encoding="utf-8")
    found = read_surface(path, size_m=9e-8)
    np.testing.assert_allclose(found.height_m, heights, rtol=1e-8)
    assert (found.width_m, found.depth_m) == pytest.approx((9e-8, 6e-8))
    with pytest.raises(ConfigError, match="without a size: give its width"):
        read_surface(path)
    path.write_text(f"# Width: 0.09 µm\n# Height: 120 nm\n{said}{text}", encoding="utf-8")
    found = read_surface(path)
    assert (found.width_m, found.depth_m) == pytest.approx((9e-8, 1.2e-7))


@pytest.mark.parametrize(
    ("head", "factor", "reason"),
    [
        ("", 1e9, "its values are not heights in m: write their unit"),
        ("# Value units: V\n", 1.0, "the unit of the heights of channel heights is 'V'; it must be a length"),
        ("# Width: 3 furlong\n", 1.0, "the unit of the width in its head is 'furlong'"),
    ],
)
def test_a_matrix_whose_heights_have_no_unit_or_an_unknown_one_is_refused(tmp_path, head, factor, reason):
    path = tmp_path / "m.csv"
    values = factor * np.random.default_rng(1).uniform(1e-9, 9e-9, (5, 5))
    path.write_text(head + "\n".join(",".join(f"{v:.6e}" for v in row) for row in values) + "\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=reason):
        read_surface(path, size_m=1e-7)

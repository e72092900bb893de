"""Height maps: shapes, interpolation, and what a sphere sees of them, against closed forms."""

from inspect import signature
from pathlib import Path

import numpy as np
import pytest

from telenano.afm.sample.surface import SHAPES, checked, dots, flat, grating, height_at
from telenano.sections import SampleConfig
from telenano.settings.config import keys_of

NM = 1e-9
INSTRUMENT = Path(__file__).parents[3] / "docs" / "instrument.md"


def at(surface, x_m, y_m):
    return height_at(surface.height_m, surface.step_x_m, surface.step_y_m, x_m, y_m)


def test_a_plane_is_interpolated_without_error_and_goes_on_level_outside():
    x, y = np.meshgrid((np.arange(40) + 0.5) * NM, (np.arange(20) + 0.5) * 2 * NM)
    tilted = checked(0.1 * x - 0.03 * y, 40 * NM, 40 * NM)
    height, slope_x, slope_y = at(tilted, 13.37 * NM, 21.1 * NM)
    assert height == pytest.approx(0.1 * 13.37 * NM - 0.03 * 21.1 * NM, rel=1e-12, abs=0)
    assert (slope_x, slope_y) == pytest.approx((0.1, -0.03), rel=1e-9, abs=0)
    assert at(tilted, -5 * NM, 10 * NM)[0] == at(tilted, 0.5 * NM, 10 * NM)[0]
    for x_m, y_m in ((np.nan, 0.0), (0.0, -np.inf)):
        with pytest.raises(ValueError, match="must be finite"):
            at(tilted, x_m, y_m)
    assert at(tilted, 99 * NM, 99 * NM)[0] == at(tilted, 39.5 * NM, 39 * NM)[0]


def test_dots_are_seeded_of_the_asked_size_and_apart():
    surface = dots(150 * NM, 300, 12, 5 * NM, 10 * NM, 3)
    assert np.array_equal(surface.height_m, dots(150 * NM, 300, 12, 5 * NM, 10 * NM, 3).height_m)
    assert not np.array_equal(surface.height_m, dots(150 * NM, 300, 12, 5 * NM, 10 * NM, 4).height_m)
    # twelve circles of 5 nm, none over another, and half ellipsoids of 2/3 pi r^2 h on them
    area = np.count_nonzero(surface.height_m) * surface.step_x_m * surface.step_y_m
    assert area == pytest.approx(12 * np.pi * (5 * NM) ** 2, rel=0.02, abs=0)
    volume = surface.height_m.sum() * surface.step_x_m * surface.step_y_m
    assert volume == pytest.approx(12 * 2 / 3 * np.pi * (5 * NM) ** 2 * 10 * NM, rel=0.01, abs=0)
    with pytest.raises(ValueError, match=r"400 dots of radius 5e-09 m find no room on 1.5e-07 m"):
        dots(150 * NM, 32, 400, 5 * NM, 10 * NM, 0)


def test_a_grating_has_its_period_and_duty():
    surface = grating(150 * NM, 600, 50 * NM, 8 * NM)
    assert set(np.unique(surface.height_m)) == {0.0, 8 * NM}
    assert np.mean(surface.height_m > 0) == pytest.approx(0.5, rel=1e-3, abs=0)
    assert at(surface, 25 * NM, 70 * NM)[0] == 8 * NM
    assert at(surface, 50 * NM, 70 * NM)[0] == 0.0


def test_a_sphere_is_kept_up_beside_a_step_by_its_own_shape():
    surface = checked(grating(100 * NM, 2000, 100 * NM, 4 * NM).height_m[:8], 100 * NM, 100 * NM)
    seen = surface.dilated(10 * NM)
    # the ridge begins at 25 nm: at a distance d before it the sphere is up by step + sqrt(R^2 - d^2) - R
    for distance in (1.0, 3.0, 6.0):
        expected = max(0.0, 4.0 + np.sqrt(100.0 - distance**2) - 10.0) * NM
        assert at(seen, (25.0 - distance) * NM, 50 * NM)[0] == pytest.approx(expected, rel=0, abs=0.03 * NM)
    assert at(seen, 10 * NM, 50 * NM)[0] == 0.0


def test_a_sphere_on_a_sphere_is_seen_with_the_sum_of_the_radii():
    # a cap of radius r, seen by a tip of radius R, is a cap of radius r + R of the same height
    x, y = np.meshgrid((np.arange(160) - 79.5) * 0.5 * NM, (np.arange(160) - 79.5) * 0.5 * NM)
    squared = x**2 + y**2
    cap = np.sqrt(np.maximum((20 * NM) ** 2 - squared, (16 * NM) ** 2)) - 16 * NM
    seen = checked(cap, 80 * NM, 80 * NM).dilated(10 * NM).height_m
    expected = np.sqrt(np.maximum((30 * NM) ** 2 - squared, 0.0)) - 26 * NM
    inside = squared < (15 * NM) ** 2
    assert np.abs(seen - expected)[inside].max() < 0.02 * NM


def test_dilation_never_lowers_and_leaves_coarse_and_level_maps_alone():
    surface = dots(150 * NM, 128, 5, 5 * NM, 10 * NM, 1)
    assert np.all(surface.dilated(7 * NM).height_m >= surface.height_m)
    assert np.array_equal(surface.dilated(0.0).height_m, surface.height_m)
    assert np.array_equal(flat(1e-6, 16).dilated(50 * NM).height_m, np.zeros((16, 16)))
    with pytest.raises(ValueError, match=r"tip radius = -1.0 m must be finite and >= 0 m"):
        surface.dilated(-1.0)
    with pytest.raises(ValueError, match="take a coarser map or a smaller tip"):
        grating(1e-6, 2048, 1e-7, 1e-6).dilated(1e-6)


@pytest.mark.parametrize(
    ("heights", "width", "what"),
    [
        (np.zeros(9), 1e-7, r"has the shape \(9,\)"),
        (np.zeros((1, 9)), 1e-7, r"has the shape \(1, 9\)"),
        (np.full((4, 4), np.nan), 1e-7, "has 16 heights that are not finite"),
        (np.array([[0.0, 1.0], [0.0, 0.0]]), 1e-7, "is its unit of height right"),
        (np.zeros((4, 4)), 0.0, "has a width of 0 m"),
        (np.zeros((4, 4)), np.inf, "has a width of inf m"),
    ],
)
def test_what_cannot_be_scanned_is_refused(heights, width, what):
    with pytest.raises(ValueError, match=what):
        checked(heights, width, 1e-7)


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_is_made_of_the_keys_of_a_sample_and_documented(name: str) -> None:
    sample = SampleConfig.model_validate({"name": name, "size_m": 90 * NM, "pixels": 20, "dot_count": 2})
    surface = sample.build()
    assert (surface.height_m.shape, surface.width_m) == ((20, 20), pytest.approx(90 * NM, rel=1e-9, abs=0))
    parameters = signature(SHAPES[name]).parameters
    assert parameters.keys() <= keys_of(SampleConfig).keys()
    (row,) = (line for line in INSTRUMENT.read_text("utf-8").splitlines() if line.startswith(f"| `{name}` |"))
    assert all(f"`{key}`" in row for key in parameters.keys() - {"size_m", "pixels"})

"""Particles in an image: their places, radii and errors, in noise, with lost pixels, beside each other and touching."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from telenano_lab.assembly.find import FoundParticle, find_particles, fixed_places, sphere_m
from telenano_lab.assembly.particles.tip_shape import tip_shape

from telenano.testing import run_program

TIP = tip_shape(10e-9, math.radians(15.0))
STEP = 62.5e-9


def image(
    places: list[tuple[float, float]], pixels: int = 48, noise_m: float = 0.0, seed: int = 0, radius_m: float = 250e-9
) -> np.ndarray:
    """Return the heights that a tip sees of spheres, a pixel each 62.5 nm."""
    axis = (np.arange(pixels) - 0.5 * (pixels - 1)) * STEP
    heights = np.zeros((pixels, pixels))
    for x, y in places:
        distance = np.hypot(axis[None, :] - x, axis[:, None] - y)
        heights = np.maximum(heights, sphere_m(TIP, radius_m, distance))
    return heights + noise_m * np.random.Generator(np.random.PCG64(seed)).normal(size=heights.shape)


def found_in(heights: np.ndarray) -> list[FoundParticle]:
    return find_particles(heights, STEP, STEP, TIP)


@pytest.mark.parametrize(("noise_nm", "error_nm"), [(0.0, 0.01), (1.0, 0.15), (5.0, 0.7)])
def test_the_centre_of_a_particle_is_found_far_within_a_pixel(noise_nm: float, error_nm: float) -> None:
    squares, radii = [], []
    for seed in range(20):
        x, y = np.random.Generator(np.random.PCG64(100 + seed)).uniform(-40e-9, 40e-9, 2).tolist()
        (one,) = found_in(image([(x, y)], 24, noise_nm * 1e-9, seed))
        squares.append(((one.x_m - x) ** 2 + (one.y_m - y) ** 2) / 2.0)
        radii.append(one.radius_m)
        assert not one.is_cluster
    assert math.sqrt(np.mean(squares)) * 1e9 < error_nm
    assert np.mean(radii) == pytest.approx(250e-9, rel=2e-3)


def test_the_stated_error_is_that_which_is_made() -> None:
    ratios = []
    for seed in range(60):
        x, y = np.random.Generator(np.random.PCG64(seed)).uniform(-40e-9, 40e-9, 2).tolist()
        (one,) = found_in(image([(x, y)], 24, 3e-9, seed))
        ratios += [(one.x_m - x) / one.x_error_m, (one.y_m - y) / one.y_error_m]
    assert 0.75 < math.sqrt(np.mean(np.square(ratios))) < 1.3


def test_tilted_lines_with_offsets_and_lost_pixels_do_not_move_a_particle() -> None:
    random = np.random.Generator(np.random.PCG64(7))
    places = [(-8e-7, 3e-7), (5e-7, -6e-7), (7e-7, 8e-7)]
    heights = image(places, 48, 1e-9)
    heights += np.linspace(0.0, 40e-9, 48)[None, :] + random.normal(0.0, 20e-9, (48, 1))
    heights[random.random(heights.shape) < 0.03] = np.nan
    found = found_in(heights)
    assert len(found) == 3
    for (x, y), one in zip(places, found, strict=True):
        assert math.dist((one.x_m, one.y_m), (x, y)) < 3e-9


@pytest.mark.parametrize("apart_nm", [500.0, 560.0, 800.0])
def test_spheres_that_touch_are_two(apart_nm: float) -> None:
    found = found_in(image([(-0.5e-9 * apart_nm, 0.0), (0.5e-9 * apart_nm, 0.0)], 40, 1e-9))
    assert len(found) == 2
    assert found[1].x_m - found[0].x_m == pytest.approx(apart_nm * 1e-9, rel=2e-2)


def test_what_is_no_sphere_is_said_to_be_a_cluster_and_an_empty_image_has_none() -> None:
    axis = (np.arange(40) - 19.5) * STEP
    ridge = np.where((np.abs(axis[:, None]) < 2e-7) & (np.abs(axis[None, :]) < 9e-7), 300e-9, 0.0)
    assert all(one.is_cluster for one in found_in(ridge))
    assert found_in(image([], 40, 2e-9)) == []
    assert found_in(np.full((8, 8), np.nan)) == []


@pytest.mark.parametrize("heights", [np.zeros(5), np.zeros((2, 9))])
def test_what_is_no_image_is_refused(heights: np.ndarray) -> None:
    with pytest.raises(ValueError, match="at least 3 rows and columns"):
        found_in(heights)


@pytest.mark.parametrize("noise_nm", [0.0, 2.0])
def test_what_stands_and_is_no_sphere_is_fixed_and_a_sphere_is_not(noise_nm: float) -> None:
    heights = image([(-700e-9, 100e-9), (-300e-9, -900e-9)], 48, noise_nm * 1e-9)
    reach_m = 333.48e-9
    spheres = found_in(heights)
    assert fixed_places(heights, STEP, STEP, spheres, reach_m) == []
    axis = (np.arange(48) - 23.5) * STEP
    block = (axis[None, :] > 0.6e-6) & (axis[None, :] < 1.0e-6) & (np.abs(axis[:, None] - 0.5e-6) < 0.4e-6)
    heights = np.where(block, heights + 80e-9, heights)
    spheres = [one for one in found_in(heights) if abs(one.radius_m / 250e-9 - 1.0) < 0.3]
    assert len(spheres) == 2
    places = fixed_places(heights, STEP, STEP, spheres, reach_m)
    assert len(places) >= 2
    assert all(0.5e-6 < x < 1.1e-6 and 0.0 < y < 1.0e-6 for x, y in places)


def test_a_command_without_scipy_names_the_extra_that_has_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    np.save(tmp_path / "scan.npy", np.zeros((8, 8)))
    for name in ("scipy", "scipy.optimize", "scipy.ndimage"):
        monkeypatch.setitem(sys.modules, name, None)
    for name in [name for name in sys.modules if name.startswith("telenano_lab.assembly")]:
        monkeypatch.delitem(sys.modules, name)
    assert run_program("particles", tmp_path / "scan.npy", "--size", "100") == 2
    said = capsys.readouterr().err
    assert "scipy is not installed" in said and "[studies]" in said

"""The compact surface: its limits, its derivatives, its potential, and that the fit finds it."""

import math
from typing import Any

import numpy as np
import pytest
from compact_surface import force_nn, potential
from hypothesis import given
from hypothesis import strategies as st
from telenano_laws.model_mediated import ModelMediatedConfig
from telenano_laws.surface import (
    BINS,
    Surface,
    _place_roots_at_once,
    fitted,
    gradient,
    met,
    misfit,
    over,
    place_roots,
    remembered,
    root_of,
    solved_pair,
    unknown,
)

from telenano.afm import branch_force
from telenano.numerics import compiled_form
from telenano.sections import AfmConfig

FIT = ModelMediatedConfig().to_params(1e-3).fit
K, RANGE = FIT.cantilever, FIT.range_nm
MICA = Surface(9.0, FIT.kappa, 12.5)

surfaces = st.builds(Surface, st.floats(-20.0, 20.0), st.floats(0.5, 200.0), st.floats(0.0, 30.0))


@given(st.floats(1e-12, 1e4), st.floats(0.0, 100.0))
def test_root_solves_its_equation(y: float, ratio: float) -> None:
    r = root_of(y, ratio)
    assert r * r * (1.0 + ratio * r) == pytest.approx(y, rel=1e-12, abs=0.0)


def base_for(plant: Any, distance_m: float) -> float:
    """Return the base position [m] that holds the tip in contact, within a meniscus, at a distance [m]."""
    force, _ = branch_force(plant.tip, distance_m, True, True)
    return float(plant.rest_distance_m - distance_m + force / plant.stiffness_n_per_m)


def test_the_roots_of_all_samples_at_once_are_those_of_each_by_itself() -> None:
    numbers, both = np.random.default_rng(1), (place_roots, compiled_form(place_roots), _place_roots_at_once)
    for _ in range(60):
        samples = np.zeros((4, BINS))
        samples[0] = numbers.uniform(-1.0, 4.0, BINS) * 10.0 ** numbers.integers(-9, 4, BINS)
        # empty bins and a contact at a sample
        samples[0, :4] = 0.0
        contact_nm = float(numbers.choice([0.0, -3.0, samples[0, 5], numbers.uniform(-20.0, 20.0)]))
        ratio, given = float(numbers.choice([0.0, 10.0 ** numbers.uniform(-3.0, 2.0)])), []
        for place in both:
            with np.errstate(invalid="ignore", divide="ignore"):
                given.append(samples.copy())
                place(given[-1], contact_nm, ratio)
        assert given[0].tobytes() == given[1].tobytes() == given[2].tobytes()
        assert given[0][3].tolist() == [root_of(float(at) - contact_nm, ratio) for at in samples[0]]


def test_kappa_of_table_2_is_hertz() -> None:
    assert FIT.kappa == pytest.approx(4.0 / 3.0 * 4.31198e9 * math.sqrt(10e-9) * 10.0**-4.5, rel=1e-3, abs=0.0)


def test_limits_of_the_force() -> None:
    assert force_nn(MICA, K, RANGE, 9.0) == -12.5
    assert force_nn(MICA, K, RANGE, 9.0 - RANGE) == 0.0
    assert force_nn(MICA, K, RANGE, 9.0 - 0.5 * RANGE) == pytest.approx(-6.25, rel=1e-14, abs=0.0)
    # a rigid sample leaves the cantilever alone: dF/dx -> k
    hard = Surface(0.0, 1e9, 0.0)
    assert force_nn(hard, K, RANGE, 2.0) == pytest.approx(K * 2.0, rel=1e-4, abs=0.0)
    # a rigid cantilever leaves Hertz
    assert force_nn(Surface(0.0, 10.0, 0.0), 1e12, RANGE, 4.0) == pytest.approx(80.0, rel=1e-9, abs=0.0)


@given(surfaces, st.floats(0.01, 20.0))
def test_gradient_is_the_numerical_one(surface: Surface, y: float) -> None:
    x, slopes = surface.contact_nm + y, gradient(surface, K, root_of(y, surface.kappa / K))
    for index in range(3):
        step = 1e-5 * max(abs(surface[index]), y)
        ends = []
        for sign in (1.0, -1.0):
            values = list(surface)
            values[index] += sign * step
            ends.append(force_nn(Surface(*values), K, RANGE, x))
        numerical = (ends[0] - ends[1]) / (2.0 * step)
        assert slopes[index] == pytest.approx(numerical, rel=1e-4, abs=1e-6 * (1.0 + abs(surface.kappa)))


@given(surfaces, st.floats(-3.0, 20.0))
def test_force_is_the_slope_of_the_potential(surface: Surface, y: float) -> None:
    x, step = surface.contact_nm + y, 1e-5
    slope = (potential(surface, K, RANGE, x + step) - potential(surface, K, RANGE, x - step)) / (2.0 * step)
    assert slope == pytest.approx(force_nn(surface, K, RANGE, x), rel=1e-4, abs=1e-3)


def test_fit_finds_the_surface_that_made_the_samples() -> None:
    fit = unknown(FIT)
    for n in range(4000):
        x = 9.05 + 1.5 * (1.0 - math.cos(0.01 * n))
        force = force_nn(MICA, K, RANGE, x)
        fit = fitted(FIT, fit, x, force) if fit.known else met(FIT, x, force)
    assert fit.surface.contact_nm == pytest.approx(9.0, rel=0.0, abs=0.02)
    assert fit.surface.kappa == pytest.approx(MICA.kappa, rel=0.02, abs=0.0)
    assert fit.surface.adhesion_nn == pytest.approx(12.5, rel=0.01, abs=0.0)


def test_fit_reproduces_the_maugis_dugdale_contact_of_table_2() -> None:
    plant = AfmConfig().to_params().plant
    a0 = plant.tip.contact_distance_m
    deltas = np.linspace(-0.05e-9, 2e-9, 3000)
    samples = []
    for delta in np.concatenate([deltas, deltas[::-1], deltas]):
        x = base_for(plant, a0 - delta)
        samples.append((1e9 * x, 1e9 * plant.stiffness_n_per_m * (a0 - delta + x - plant.rest_distance_m)))
    fit = met(FIT, *samples[0])
    for x, force in samples[1:]:
        fit = fitted(FIT, fit, x, force)
    # the force of the model, over the whole of the range, against forces from -12.5 to +22 nN
    errors = [force_nn(fit.surface, K, RANGE, x) - force for x, force in samples[:3000:50]]
    assert np.abs(errors).max() < 0.4
    # and its stiffness at the base, k k_c / (k + k_c), with the paper's contact stiffness at 0.2, 0.5, 1 and 2 nm
    for delta, contact in ((0.2e-9, 13.15), (0.5e-9, 19.6), (1e-9, 27.4), (1.99e-9, 38.6)):
        x = 1e9 * base_for(plant, a0 - delta)
        slope = (force_nn(fit.surface, K, RANGE, x + 1e-4) - force_nn(fit.surface, K, RANGE, x - 1e-4)) / 2e-4
        assert slope == pytest.approx(40.0 * contact / (40.0 + contact), rel=0.05, abs=0.0)


def test_fit_recovers_from_a_false_start_and_finds_a_surface_that_moved() -> None:
    fit = met(FIT, 7.0, -1.0)
    for truth in (MICA, Surface(9.4, 0.5 * MICA.kappa, 6.0)):
        for n in range(6000):
            x = truth.contact_nm + 1.0 + 0.8 * math.sin(0.02 * n)
            fit = fitted(FIT, fit, x, force_nn(truth, K, RANGE, x))
        for y in (0.3, 1.0, 1.7):
            x = truth.contact_nm + y
            expected = force_nn(truth, K, RANGE, x)
            assert force_nn(fit.surface, K, RANGE, x) == pytest.approx(expected, rel=0.02, abs=0.05)


def test_a_step_never_fits_worse() -> None:
    rng = np.random.default_rng(5)
    fit = met(FIT, 9.5, 3.0)
    for x in rng.uniform(9.2, 11.5, 300):
        force = force_nn(MICA, K, RANGE, x) + rng.normal(0.0, 0.3)
        before = misfit(remembered(FIT, fit, x, force))
        fit = fitted(FIT, fit, x, force)
        assert misfit(fit) <= before


def test_a_fit_keeps_the_roots_of_its_samples_under_its_surface() -> None:
    fit = met(FIT, 9.5, 3.0)
    for x in np.random.default_rng(7).uniform(9.2, 11.5, 60):
        fit = fitted(FIT, fit, float(x), force_nn(MICA, K, RANGE, float(x)))
    full = fit.samples[2] > 0.0
    assert full.sum() > 10
    assert np.array_equal(fit.samples[:, full], over(FIT, fit, fit.surface).samples[:, full])


def test_standing_still_does_not_let_the_fit_drift() -> None:
    fit = met(FIT, 9.5, force_nn(MICA, K, RANGE, 9.5))
    for n in range(3000):
        x = 10.0 + 0.5 * math.sin(0.05 * n)
        fit = fitted(FIT, fit, x, force_nn(MICA, K, RANGE, x))
    before = fit.surface
    for _ in range(20_000):
        fit = fitted(FIT, fit, 10.0, force_nn(MICA, K, RANGE, 10.0))
    np.testing.assert_allclose(force_nn(fit.surface, K, RANGE, 10.0), force_nn(MICA, K, RANGE, 10.0), rtol=1e-3)
    np.testing.assert_allclose(fit.surface, before, rtol=1e-3)


@given(st.floats(1e-3, 1e3), st.floats(-0.999, 0.999), st.floats(1e-3, 1e3), st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_pair_of_equations_is_solved(p: float, correlation: float, r: float, u: float, v: float) -> None:
    q = correlation * math.sqrt(p * r)
    x, y = solved_pair(p, q, r, u, v)
    scale = abs(p * x) + abs(q * y) + abs(q * x) + abs(r * y)
    assert p * x + q * y == pytest.approx(u, rel=0.0, abs=1e-12 * scale + 1e-300)
    assert q * x + r * y == pytest.approx(v, rel=0.0, abs=1e-12 * scale + 1e-300)

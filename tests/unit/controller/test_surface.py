"""The compact surface: its limits, its derivatives, its potential, and that the fit finds it."""

import math

import numpy as np
import pytest
from compact_surface import force_nn, potential
from hypothesis import given
from hypothesis import strategies as st
from instrument_theory import base_for

from services.afm_node.config import AfmConfig
from services.controller.laws.model_mediated import ModelMediatedConfig
from services.controller.laws.shared.surface import (
    BINS,
    Surface,
    _place_roots_at_once,
    fitted,
    met,
    place_roots,
    root_of,
    unknown,
)
from services.numerics.compiled import compiled_form

FIT = ModelMediatedConfig().to_params(1e-3).fit
K, RANGE = FIT.cantilever, FIT.range_nm
MICA = Surface(9.0, FIT.kappa, 12.5)

surfaces = st.builds(Surface, st.floats(-20.0, 20.0), st.floats(0.5, 200.0), st.floats(0.0, 30.0))


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
        x = base_for(plant, a0 - delta, True, True)
        samples.append((1e9 * x, 1e9 * plant.stiffness_n_per_m * (a0 - delta + x - plant.rest_distance_m)))
    fit = met(FIT, *samples[0])
    for x, force in samples[1:]:
        fit = fitted(FIT, fit, x, force)
    # the force of the model, over the whole of the range, against forces from -12.5 to +22 nN
    errors = [force_nn(fit.surface, K, RANGE, x) - force for x, force in samples[:3000:50]]
    assert np.abs(errors).max() < 0.4
    # and its stiffness at the base, k k_c / (k + k_c), with the paper's contact stiffness at 0.2, 0.5, 1 and 2 nm
    for delta, contact in ((0.2e-9, 13.15), (0.5e-9, 19.6), (1e-9, 27.4), (1.99e-9, 38.6)):
        x = 1e9 * base_for(plant, a0 - delta, True, True)
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

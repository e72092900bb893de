"""The exact step: closed forms in each regime of damping, digits that no processor changes, parameters at the edges."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from telenano.numerics.discretisation import approach, decay, exact_discretisation
from telenano.sections import VirtualImpedanceConfig

T = 1e-3
# a closed form in doubles loses a few last bits itself, ours none
FEW_BITS = 1e-15


def test_mass_and_damper_are_the_exponential_approach() -> None:
    step = exact_discretisation(10.0, 2000.0, 0.0, T)
    decay = 2000.0 / 10.0
    assert step.phi_xx == 1.0
    assert step.phi_vx == 0.0
    assert step.phi_vv == pytest.approx(math.exp(-decay * T), rel=FEW_BITS, abs=0.0)
    assert step.phi_xv == pytest.approx(-math.expm1(-decay * T) / decay, rel=FEW_BITS, abs=0.0)
    assert step.gamma_v == pytest.approx(-math.expm1(-decay * T) / 2000.0, rel=FEW_BITS, abs=0.0)


def test_mass_and_spring_turn_the_phase_by_the_natural_frequency() -> None:
    step = exact_discretisation(2.0, 0.0, 2.0 * 30.0**2, T)
    assert step.phi_xx == step.phi_vv == pytest.approx(math.cos(30.0 * T), rel=FEW_BITS, abs=0.0)
    assert step.phi_xv == pytest.approx(math.sin(30.0 * T) / 30.0, rel=FEW_BITS, abs=0.0)
    assert step.gamma_x == pytest.approx(2.0 * math.sin(15.0 * T) ** 2 / (2.0 * 900.0), rel=FEW_BITS, abs=0.0)


def test_critical_damping_has_no_special_case() -> None:
    step = exact_discretisation(1.0, 2.0 * 50.0, 50.0**2, 0.02)
    decay = math.exp(-1.0)
    assert step.phi_xx == pytest.approx(2.0 * decay, rel=FEW_BITS, abs=0.0)
    assert step.phi_xv == pytest.approx(0.02 * decay, rel=FEW_BITS, abs=0.0)
    assert step.phi_vv == pytest.approx(0.0, abs=1e-17)


def test_a_free_mass_has_the_figures_of_school() -> None:
    assert exact_discretisation(1.0, 0.0, 0.0, 0.5) == (1.0, 0.5, 0.0, 1.0, 0.125, 0.5)


def test_the_papers_impedance_has_these_digits_on_every_processor() -> None:
    step = VirtualImpedanceConfig().to_params(T).impedance
    assert step.phi_vv.hex() == "0x1.a330ad6166159p-1"
    assert step.gamma_x.hex() == "0x1.923d676e96e4ep-25"


@pytest.mark.check("takes 0.8 s")
@given(st.floats(1e-3, 1e3), st.floats(0.0, 1e4), st.floats(0.0, 1e4), st.sampled_from([1e-4, 1e-3, 1e-2]))
def test_it_is_the_matrix_exponential(mass: float, damping: float, stiffness: float, period_s: float) -> None:
    continuous = np.zeros((3, 3))
    continuous[0, 1] = 1.0
    continuous[1] = [-stiffness / mass, -damping / mass, 1.0 / mass]
    discrete = expm(continuous * period_s)
    step = exact_discretisation(mass, damping, stiffness, period_s)
    # rows differ by the period in their units; scipy's error is relative to the whole matrix
    scale = np.array([[1.0, period_s, period_s**2 / mass], [1.0 / period_s, 1.0, period_s / mass]])
    ours = np.array([[step.phi_xx, step.phi_xv, step.gamma_x], [step.phi_vx, step.phi_vv, step.gamma_v]])
    size = 1.0 + period_s * (damping / mass + math.sqrt(stiffness / mass))
    np.testing.assert_allclose(ours / scale, discrete[:2] / scale, rtol=0.0, atol=1e-14 * size**2)


@pytest.mark.parametrize("large", [1e12, 1e150, 1e300])
def test_parameters_of_any_size_give_finite_figures(large: float) -> None:
    heavy = exact_discretisation(large, 1.0 / large, 1.0 / large, T)
    assert (heavy.phi_xx, heavy.phi_vv) == (1.0, 1.0)
    stiff = exact_discretisation(1.0, large, large, T)
    assert all(math.isfinite(figure) for figure in stiff)
    # what is left is the slow way back, of the time constant B / K = 1 s
    assert stiff.phi_xx == pytest.approx(math.exp(-T), rel=FEW_BITS + 2.0 / large, abs=0.0)


@given(st.floats(0.0, 700.0))
def test_decay_and_approach_are_the_exponential(ratio: float) -> None:
    assert decay(ratio) == pytest.approx(math.exp(-ratio), rel=FEW_BITS, abs=0.0)
    assert approach(ratio) == pytest.approx(-math.expm1(-ratio), rel=FEW_BITS, abs=0.0)


def test_decay_and_approach_at_the_edges() -> None:
    assert (decay(0.0), approach(0.0)) == (1.0, 0.0)
    assert (decay(math.inf), approach(math.inf)) == (0.0, 1.0)
    assert (decay(1e300), approach(1e300)) == (0.0, 1.0)
    assert approach(1e-300) == 1e-300

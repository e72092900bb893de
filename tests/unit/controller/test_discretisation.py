"""The exact step: closed forms in each regime of damping, digits that no processor changes, parameters at the edges."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from services.controller.discretisation import exact_discretisation
from services.controller.laws.virtual_impedance import VirtualImpedanceConfig

T = 1e-3
# a closed form in doubles loses a few last bits itself, ours none
FEW_BITS = 1e-15


def test_the_papers_impedance_has_these_digits_on_every_processor() -> None:
    step = VirtualImpedanceConfig().to_params(T).impedance
    assert step.phi_vv.hex() == "0x1.a330ad6166159p-1"
    assert step.gamma_x.hex() == "0x1.923d676e96e4ep-25"


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

import math

import pytest
from scipy.optimize import minimize_scalar

from telenano.afm.contact.lennard_jones import contact_distance_m, lennard_jones_force, minimum_distance_m

H, R, SIGMA = 1.89e-19, 10e-9, 3.49e-10


def force(h):
    return lennard_jones_force(h, H, R, SIGMA)[0]


def test_contact_point_and_minimum_are_those_of_table_2():
    assert round(contact_distance_m(SIGMA) * 1e9, 6) == 0.197988
    assert round(minimum_distance_m(SIGMA) * 1e9, 4) == 0.2494
    assert round(force(minimum_distance_m(SIGMA)) * 1e9, 3) == -3.797


def test_force_is_zero_at_the_contact_point_and_repels_inside():
    a0 = contact_distance_m(SIGMA)
    assert abs(force(a0)) < 1e-12 * abs(force(minimum_distance_m(SIGMA)))
    assert force(0.999 * a0) > 0 > force(1.001 * a0)


def test_minimum_agrees_with_a_numerical_search():
    found = minimize_scalar(
        lambda x: force(x * 1e-9) * 1e9, bounds=(0.2, 0.4), method="bounded", options={"xatol": 1e-9}
    )
    assert math.isclose(found.x * 1e-9, minimum_distance_m(SIGMA), rel_tol=1e-6)


@pytest.mark.parametrize("h", [0.2e-9, 0.25e-9, 0.3e-9, 1e-9, 1e-8])
def test_gradient_is_the_numerical_derivative(h):
    step = 1e-5 * h
    numerical = (force(h + step) - force(h - step)) / (2 * step)
    assert math.isclose(lennard_jones_force(h, H, R, SIGMA)[1], numerical, rel_tol=1e-6, abs_tol=1e-6)


def test_far_away_it_is_van_der_waals():
    assert math.isclose(force(1e-7), -H * R / (6 * 1e-7**2), rel_tol=1e-12)


@pytest.mark.parametrize("sigma", [0.0, -1e-10, math.nan, math.inf])
def test_an_impossible_sigma_is_named(sigma):
    with pytest.raises(ValueError, match=r"sigma = .* m must be finite and > 0 m"):
        contact_distance_m(sigma)

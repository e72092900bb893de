import math

import pytest

from telenano.afm.contact.capillary import (
    meniscus_force,
    meniscus_radius_m,
    printed_meniscus_force,
    relative_humidity,
)
from telenano.afm.contact.lennard_jones import contact_distance_m

A0 = contact_distance_m(3.49e-10)
STRENGTH = 4 * math.pi * 10e-9 * 0.073
BRIDGE, BREAK = 2.4e-9, 4e-9


def printed(h, retracting):
    return printed_meniscus_force(h, retracting, STRENGTH, BRIDGE, A0, BREAK)


def test_the_printed_branches_differ_at_the_contact_point():
    # E4: -3.34 nN where the approach law has -9.17 nN
    assert round(meniscus_force(A0, STRENGTH, BRIDGE, A0)[0] * 1e9, 2) == -9.17
    assert round(printed(A0, True)[0] * 1e9, 2) == -3.34


def test_consistent_law_is_frozen_in_contact():
    assert meniscus_force(-1e-9, STRENGTH, BRIDGE, A0) == (-STRENGTH, 0.0)
    assert math.isclose(meniscus_force(A0 + BRIDGE, STRENGTH, BRIDGE, A0)[0], -STRENGTH / 2, rel_tol=1e-12)


def test_the_printed_approach_acts_beyond_two_r1_only():
    assert printed(BRIDGE, False)[0] < 0
    assert printed(math.nextafter(BRIDGE, 0), False) == (0.0, 0.0)
    assert math.isclose(printed(BRIDGE, False)[0], meniscus_force(BRIDGE, STRENGTH, BRIDGE, A0)[0], rel_tol=1e-12)


def test_the_printed_retract_acts_up_to_the_breaking_length():
    assert math.isclose(printed(BREAK, True)[0], -STRENGTH / (1 + 2 * BREAK / BRIDGE), rel_tol=1e-12)
    assert printed(math.nextafter(BREAK, 1), True) == (0.0, 0.0)


@pytest.mark.parametrize("h", [0.3e-9, 1e-9, 3e-9])
def test_gradients_are_numerical_derivatives(h):
    step = 1e-14
    laws = [
        lambda x: meniscus_force(x, STRENGTH, BRIDGE, A0),
        lambda x: printed(x, True),
        lambda x: printed(x, False),
    ]
    for law in laws:
        numerical = (law(h + step)[0] - law(h - step)[0]) / (2 * step)
        assert math.isclose(law(h)[1], numerical, rel_tol=1e-5, abs_tol=1e-9)


def test_humidity_and_radius():
    assert round(relative_humidity(1.2e-9) * 100, 1) == 63.8
    for humidity in (0.01, 0.3, 0.638, 0.99):
        assert math.isclose(relative_humidity(meniscus_radius_m(humidity)), humidity, rel_tol=1e-12)


@pytest.mark.parametrize("humidity", [0.0, 1.0, -0.1, 63.8, math.nan])
def test_a_humidity_that_is_no_fraction_is_refused(humidity):
    with pytest.raises(ValueError, match=r"relative humidity = .* fraction between 0 and 1"):
        meniscus_radius_m(humidity)


@pytest.mark.parametrize("radius", [0.0, -1e-9, math.nan, math.inf])
def test_an_impossible_radius_is_refused(radius):
    with pytest.raises(ValueError, match=r"r1 = .* m must be finite and > 0 m"):
        relative_humidity(radius)

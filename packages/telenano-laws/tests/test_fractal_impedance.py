"""The force of the spring on its way out and back has the numbers of the check case."""

import math

import pytest
from telenano_laws.fractal_impedance import Turn, faded, fractal, fractal_force, outward_force, stored


def test_the_way_back_gives_in_its_first_half_what_it_takes_in_its_second() -> None:
    spring, turn, forces = fractal(500.0, 5.0, 0.009, 0.010), Turn(0.0, 0.0), []
    for distance in (0.002, 0.004, 0.003, 0.002, 0.001, 0.0, -0.001):
        turn, force = fractal_force(spring, turn, distance)
        forces.append(force)
    assert forces == pytest.approx([1.0, 2.0, 1.0, 0.0, -1.0, 0.0, -0.5], abs=1e-12)


def test_force_and_energy_near_the_greatest_force() -> None:
    spring = fractal(500.0, 5.0, 0.009, 0.010)
    assert outward_force(spring, 0.012) == pytest.approx(5.0, rel=1e-9)
    assert stored(spring, 0.012) == pytest.approx(0.035225, rel=1e-9)
    step = 1e-6
    for place in (0.004, 0.00905, 0.0095, 0.02):
        slope = (stored(spring, place + step) - stored(spring, place - step)) / (2.0 * step)
        assert slope == pytest.approx(outward_force(spring, place), rel=1e-5)


@pytest.mark.parametrize("ratio", [0.0, 1e-3, 0.7, 5.0, 40.0, 600.0])
def test_the_exponential_is_right_without_a_library(ratio: float) -> None:
    assert faded(ratio) == pytest.approx(math.exp(-ratio), rel=1e-11)

"""Direct reflection: steady state, and the delay that its phase margin allows."""

import math
from typing import Any

import numpy as np
import pytest


def critical_ticks(stiffness: float) -> float:
    """Give the delay [ms] at the phase margin of K_h e^(-sT) / (M s^2 + B s), less the half period of the hold."""
    k, m, b = 150.0 * stiffness, 0.5, 100.0
    w2 = (-(b * b) + math.sqrt(b**4 + 4.0 * m * m * k * k)) / (2.0 * m * m)
    w = math.sqrt(w2)
    return 1e3 * (math.pi / 2.0 - math.atan(m * w / b)) / w - 0.5


def rest_of(run: Any) -> tuple[float, float]:
    return float(np.ptp(1e8 * run.force_n[1500:2000])), float(np.ptp(1e8 * run.force_n[-500:]))


@pytest.mark.parametrize("stiffness", [10.0, 20.0, 38.0])
def test_force_is_reflected_as_it_is(run_loop: Any, stiffness: float) -> None:
    run = run_loop("position_force", lambda n: 1.0, lambda x: stiffness * x, 3000)
    assert 1e8 * run.force_n[-1] == pytest.approx(1.0, rel=1e-9, abs=0.0)


@pytest.mark.parametrize("stiffness", [10.0, 20.0, 38.0])
def test_oscillation_dies_just_below_the_delay_margin_and_grows_just_above(run_loop: Any, stiffness: float) -> None:
    margin = critical_ticks(stiffness)
    below, above = math.floor(0.97 * margin), math.ceil(1.03 * margin)
    run = run_loop("position_force", lambda n: 0.1, lambda x: stiffness * x, 4000, backward=lambda n: below)
    earlier, later = rest_of(run)
    assert later < 0.9 * earlier
    run = run_loop("position_force", lambda n: 0.1, lambda x: stiffness * x, 4000, backward=lambda n: above)
    earlier, later = rest_of(run)
    assert later > 1.1 * earlier

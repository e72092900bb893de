"""A drift in z that wanders: its speed has the size and the time constant that are set, and it is off without them."""

import math

import numpy as np
import pytest

from telenano.afm.disturbances import DisturbanceConfig, noise_start, noise_step


def drifted(seed: int, count: int, dt: float, **drift: float) -> np.ndarray:
    """Return how far the base has drifted after each step [m]."""
    config = DisturbanceConfig.model_validate({"seed": seed, "drift": {"enabled": True, **drift}})
    state, found = noise_start(), []
    for _ in range(count):
        state, noise = noise_step(config, state, 40.0, dt)
        found.append(noise.drift_m)
    return np.array(found)


@pytest.mark.parametrize("time_s", [2.0, 20.0])
def test_the_speed_has_its_size_and_forgets_itself_in_its_time(time_s: float) -> None:
    dt = 0.1
    speeds = np.concatenate(
        [
            np.diff(drifted(seed, 1500, dt, speed_m_per_s=0.0, wander_m_per_s=50e-12, wander_s=time_s)) / dt
            for seed in range(12)
        ]
    ).reshape(12, -1)
    assert math.sqrt(float(np.mean(speeds**2))) == pytest.approx(50e-12, rel=0.25, abs=0)
    later = round(time_s / dt)
    kept = float(np.mean(speeds[:, later:] * speeds[:, :-later]) / np.mean(speeds**2))
    assert kept == pytest.approx(math.exp(-1.0), abs=0.2)


def test_it_comes_on_top_of_the_drift_that_stands_and_another_seed_wanders_elsewhere() -> None:
    still = drifted(3, 50, 1e-3, speed_m_per_s=1e-11)
    moving = drifted(3, 50, 1e-3, speed_m_per_s=1e-11, wander_m_per_s=5e-11, wander_s=10.0)
    assert still[-1] == pytest.approx(1e-11 * 0.05, rel=1e-12, abs=0)
    assert 0.0 < abs(moving[-1] - still[-1]) < 5.0 * 5e-11 * 0.05
    assert moving[-1] != drifted(4, 50, 1e-3, speed_m_per_s=1e-11, wander_m_per_s=5e-11, wander_s=10.0)[-1]

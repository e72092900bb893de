"""What the endurance benchmark calls a growth of memory: a leak is one, a further arena of the allocator is none."""

import numpy as np
import pytest
from soak import MOST_GROWTH_BYTES_PER_MIN, lasting_slope

T_S = np.arange(0.0, 540.0, 1.0)


def drawn(seed: int, leak_per_min: float, step_s: float) -> np.ndarray:
    """Return sizes [bytes] with noise, a leak, and one step of 8 MB."""
    noise = np.random.default_rng(seed).normal(0.0, 2e5, T_S.size)
    return 80e6 + noise + leak_per_min / 60.0 * T_S + 8e6 * np.heaviside(T_S - step_s, 1.0)


@pytest.mark.parametrize("seed", range(20))
def test_a_leak_grows_in_both_halves_and_a_step_in_one(seed: int) -> None:
    step_s = np.random.default_rng(1000 + seed).uniform(20.0, 520.0)
    assert 60.0 * lasting_slope(T_S, drawn(seed, 0.0, step_s)) < 0.5 * MOST_GROWTH_BYTES_PER_MIN
    assert 60.0 * lasting_slope(T_S, drawn(seed, 2.0 * MOST_GROWTH_BYTES_PER_MIN, step_s)) > MOST_GROWTH_BYTES_PER_MIN

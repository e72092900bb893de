"""Verdicts on forces that rest but for one small pulse near their end, which a fit takes for modes that grow."""

import math
from collections import Counter

import numpy as np
import pytest

from telenano.analysis.verdict import judge

PERIOD_S = 0.004


def log_uniform(generator: np.random.Generator, least: float, greatest: float) -> float:
    return least * (greatest / least) ** float(generator.random())


def kind(seed: int, is_pulse: bool) -> str:
    """Return the verdict on a hold of 1.6 N with a small pulse in its last half, or with a growing swing.

    The pulse has 1 to 20 mN, and dies out within 20 to 500 ms. The swing ends at 0.1 to 0.5 N, and grows by e^1.5 or
    more in the hold, which is of 1.5 to 6 s.
    """
    generator = np.random.Generator(np.random.PCG64(seed))
    length_s, noise_n = float(generator.uniform(1.5, 6.0)), log_uniform(generator, 1e-9, 1e-4)
    time_s = np.arange(0.0, length_s, PERIOD_S)
    swing = np.cos(2.0 * math.pi * (log_uniform(generator, 3.0, 40.0) * time_s + generator.random()))
    if is_pulse:
        since_s = time_s - length_s * float(generator.uniform(0.5, 0.98))
        decay_s, size_n = log_uniform(generator, 0.02, 0.5), log_uniform(generator, 1e-3, 2e-2)
        swing = np.where(since_s >= 0.0, size_n * np.exp(-np.maximum(since_s, 0.0) / decay_s) * swing, 0.0)
    else:
        growth_per_s, end_n = log_uniform(generator, 1.5, 40.0) / length_s, log_uniform(generator, 0.1, 0.5)
        swing = end_n * np.exp(growth_per_s * (time_s - length_s)) * swing
    return judge(time_s, 1.0 + swing + noise_n * generator.normal(size=time_s.size), 1.6, 1.0, 0.0).kind


@pytest.mark.check("judges 30 holds")
def test_a_late_pulse_is_no_growth() -> None:
    assert Counter(kind(seed, True) for seed in range(30)) == {"stable": 30}


@pytest.mark.check("judges 30 holds")
def test_a_swing_that_grows_until_the_end_is_one() -> None:
    assert Counter(kind(seed, False) for seed in range(30)) == {"diverged": 30}

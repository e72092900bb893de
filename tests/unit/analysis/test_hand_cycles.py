"""How many cycles of the hand a session has: presses that rise and fall, and neither ramps nor noise."""

import numpy as np
import pytest

from telenano.analysis.session_judge import cycles_of

TIME_S = np.arange(0.0, 20.0, 1e-3)
SWING_N = 1.0 + 0.3 * np.sin(np.pi * TIME_S)


@pytest.mark.parametrize(
    ("force_n", "cycles"),
    [
        (np.zeros(0), 0),
        (np.full(100, 2.0), 0),
        # a ramp, and presses of Fig. 12: harder, harder still, and let go
        (np.linspace(0.0, 1.0, 500), 0),
        (np.interp(TIME_S, [0.8, 1.2, 2.6, 2.9, 4.5, 4.6], [0.0, 1.0, 1.0, 2.0, 2.0, 0.0]), 1),
        (SWING_N, 10),
        (-SWING_N, 10),
        # less than a tenth of the greatest force is a tremor
        (1.0 + 0.04 * np.sin(40.0 * TIME_S), 0),
        (SWING_N + np.random.default_rng(1).uniform(-0.05, 0.05, TIME_S.size), 10),
    ],
)
def test_cycles_are_presses_that_rise_and_fall_by_a_tenth(force_n: np.ndarray, cycles: int) -> None:
    assert cycles_of(force_n) == cycles

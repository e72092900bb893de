"""The least error of a change is the one of the closed form where the swing is alone in white noise."""

import math

import pytest
from least_errors import least_error
from plans import Plan, plan, stretches


def alone_in_white_noise() -> Plan:
    """Return the first plan of a steady swing without other modes, in white noise, over many turns."""
    for seed in range(2000):
        drawn = plan(seed)
        turns = drawn.length_s * drawn.frequency_hz if drawn.truth == "goes_on" else 0.0
        alone = len(drawn.modes) == 1 and not drawn.random_excitation_n and len(stretches(drawn)) == 1
        if drawn.motion == "sustained" and drawn.noise == "white" and alone and turns > 10.0 and drawn.length_s < 2.0:
            return drawn
    raise AssertionError("no such plan")


@pytest.mark.check("takes 2.4 s")
def test_the_bound_is_that_of_a_swing_in_white_noise() -> None:
    drawn = alone_in_white_noise()
    samples = drawn.length_s * drawn.sample_rate_hz
    due = math.sqrt(24.0 / samples) * drawn.noise_n / drawn.modes[0].amplitude_n
    assert least_error(drawn) == pytest.approx(due, rel=0.1)
    assert least_error(drawn._replace(noise_n=3.0 * drawn.noise_n)) == pytest.approx(3.0 * due, rel=0.1)

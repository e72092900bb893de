"""A late step of the feedback: how far it takes the integral, in contact and in tapping mode."""

import math

import pytest

from telenano.extend.feedback import integral_share, most_integral_share, remaining

LAG = remaining(1e-3, 150e3, 1000.0)


@pytest.mark.parametrize("lag", [None, LAG])
def test_a_step_in_time_takes_the_gain_times_its_time(lag: float | None) -> None:
    assert integral_share(100.0, 0.0, 1e-3, lag, 1e-3) == pytest.approx(0.1, rel=1e-12, abs=0.0)
    assert integral_share(100.0, 0.0, 1e-3, lag, 2.5e-3) == pytest.approx(0.25, rel=1e-12, abs=0.0)


@pytest.mark.parametrize(("lag", "share"), [(None, 0.45), (LAG, 0.5)])
@pytest.mark.parametrize("proportional", [0.0, 0.3])
def test_a_late_step_goes_no_further_than_about_half_of_what_is_stable(
    lag: float | None, share: float, proportional: float
) -> None:
    stable = most_integral_share(proportional, lag)
    late = integral_share(100.0, proportional, 1e-3, lag, 0.05)
    assert late == pytest.approx(share * stable, rel=1e-12, abs=0.0)
    assert late < 100.0 * 0.05


@pytest.mark.parametrize("lag", [None, LAG])
def test_a_gain_that_needs_more_than_that_in_a_period_keeps_what_a_period_has(lag: float | None) -> None:
    # 0.95 of the limit in contact: late or not, a step never does less than one in time
    gain_per_s = 0.95 * most_integral_share(0.0, lag) / 1e-3
    in_time = integral_share(gain_per_s, 0.0, 1e-3, lag, 1e-3)
    assert in_time == pytest.approx(gain_per_s * 1e-3, rel=1e-12, abs=0.0)
    assert integral_share(gain_per_s, 0.0, 1e-3, lag, 0.05) == pytest.approx(in_time, rel=1e-12, abs=0.0)
    assert integral_share(gain_per_s, 0.0, 1e-3, lag, 1e-4) == pytest.approx(0.1 * in_time, rel=1e-12, abs=0.0)


def test_what_remains_of_a_change_of_the_amplitude_falls_with_the_time_and_with_the_bandwidth() -> None:
    assert remaining(1e-3, 150e3, 1000.0) == pytest.approx(math.exp(-0.15 * math.pi), rel=1e-12, abs=0.0)
    # Q / (pi f) is the time constant
    assert remaining(100.0 / math.pi / 150e3, 150e3, 100.0) == pytest.approx(math.exp(-1.0), rel=1e-12, abs=0.0)

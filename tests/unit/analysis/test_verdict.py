"""Verdicts on signals whose fate is known."""

import numpy as np
import pytest

from analysis.verdict import SMALL_SHARE, WINDOWS, growth_rate, judge, window_sizes

TIME_S = np.arange(8000) * 1e-3


def ringing(growth_per_s: float, frequency_hz: float = 5.0, size: float = 0.3) -> np.ndarray:
    return 1.0 + size * np.exp(growth_per_s * TIME_S) * np.sin(2.0 * np.pi * frequency_hz * TIME_S)


@pytest.mark.parametrize("growth", [-3.0, -0.4, -0.05, 0.05, 0.4, 3.0])
@pytest.mark.parametrize("frequency", [2.5, 9.3])
def test_growth_rate_is_the_real_part_of_the_mode(growth: float, frequency: float) -> None:
    verdict = judge(TIME_S, ringing(growth, frequency), 1.0)
    assert verdict.growth_per_s == pytest.approx(growth, rel=0.02, abs=0.005)


@pytest.mark.parametrize(
    ("growth", "size", "kind"),
    [
        (-0.4, 0.3, "stable"),
        (0.4, 0.3, "diverged"),
        # growing from next to nothing is growing all the same
        (0.4, 1e-4, "diverged"),
        (0.0, 0.3, "limit_cycle"),
        (0.0, 0.51 * SMALL_SHARE, "limit_cycle"),
        (0.0, 0.49 * SMALL_SHARE, "stable"),
        # less than a tenth over the fitted windows
        (0.015, 0.3, "limit_cycle"),
        (0.025, 0.3, "diverged"),
        (-0.025, 0.3, "stable"),
    ],
)
def test_verdict(growth: float, size: float, kind: str) -> None:
    assert judge(TIME_S, ringing(growth, size=size), 1.0).kind == kind


def test_stillness_is_stable_without_a_rate() -> None:
    verdict = judge(TIME_S, np.ones_like(TIME_S), 1.0)
    assert verdict == ("stable", None, 0.0)


def test_guard_means_diverged() -> None:
    assert judge(TIME_S, ringing(-1.0), 1.0, ended_early=True).kind == "diverged"
    assert judge(TIME_S[:5], ringing(-1.0)[:5], 1.0, ended_early=True).kind == "diverged"
    assert judge(TIME_S[:0], TIME_S[:0], 1.0, ended_early=True) == ("diverged", None, 0.0)


def test_force_that_is_no_number_means_diverged() -> None:
    force = ringing(0.0)
    force[5000:] = np.nan
    assert judge(TIME_S, force, 1.0).kind == "diverged"


def test_noise_that_happens_to_rise_is_not_divergence() -> None:
    generator = np.random.default_rng(5)
    kinds = {judge(TIME_S, 1.0 + 0.1 * generator.standard_normal(8000), 1.0, noisy=True).kind for _ in range(40)}
    assert kinds == {"limit_cycle"}


@pytest.mark.parametrize(("growth", "kind"), [(0.2, "diverged"), (0.1, "limit_cycle"), (-0.2, "stable")])
def test_trend_over_a_random_link_has_to_be_a_factor_of_two(growth: float, kind: str) -> None:
    # the fitted windows span 5 s, so that 0.14 per second is a factor of two
    assert judge(TIME_S, ringing(growth), 1.0, noisy=True).kind == kind


def test_one_missed_burst_does_not_change_the_rate() -> None:
    sizes = np.array([1.0, 1.0, 0.3, 1.0, 1.0, 1.0])
    slope, trend = growth_rate(np.arange(6.0), sizes, 0.0)
    assert slope == 0.0
    assert abs(trend) < 0.7


def test_sizes_below_the_floor_count_as_nothing() -> None:
    assert growth_rate(np.arange(3.0), np.array([1.0, 1e-9, 1e-9]), 1e-7) == (None, 0.0)
    slope, trend = growth_rate(np.arange(3.0), np.array([1.0, np.exp(-2.0), 1e-9]), 1e-7)
    assert slope == pytest.approx(-2.0, rel=1e-12, abs=0.0)
    assert trend == -1.0


def test_windows_cover_the_hold() -> None:
    centres, sizes = window_sizes(TIME_S, TIME_S)
    assert len(centres) == len(sizes) == WINDOWS
    np.testing.assert_allclose(sizes, 0.999, rtol=1e-9, atol=0.0)
    assert centres[0] == pytest.approx(0.4995, rel=1e-9, abs=0.0)


def test_hold_needs_samples_and_a_pressing_hand() -> None:
    with pytest.raises(ValueError, match="15 samples"):
        judge(TIME_S[:15], TIME_S[:15], 1.0)
    with pytest.raises(ValueError, match=r"-1\.0 N"):
        judge(TIME_S, TIME_S, -1.0)

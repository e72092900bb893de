"""Steps and noise of a read-out, and how far a force goes without them, on series that are made with known ones."""

import math

import numpy as np
import pytest

from telenano.analysis.modes import LEAST_SAMPLES
from telenano.analysis.read_out import even, gone_of, line_n, moved_of, noise_of, reach_of, rounding_of

COUNT = 4000


def white(sigma_n: float, seed: int, count: int = COUNT) -> np.ndarray:
    return sigma_n * np.random.default_rng(seed).standard_normal(count)


@pytest.mark.parametrize("step_n", [1e-12, 0.02, 3.0])
def test_the_step_of_a_read_out_that_rounds_is_the_least_that_it_takes(step_n: float) -> None:
    turning = np.round(5.0 * np.sin(np.arange(COUNT) * 0.01)) * step_n
    assert rounding_of(turning) == pytest.approx(step_n, rel=1e-9, abs=0.0)
    # Blows of many steps do not hide it.
    assert rounding_of(np.where(np.arange(COUNT) % 500 == 0, 40.0 * step_n, turning)) == pytest.approx(step_n, rel=1e-9)


def test_a_read_out_rounds_where_fewer_than_a_fourth_of_its_values_differ() -> None:
    three = np.array([0.0, 1.0, 2.0])
    assert rounding_of(np.resize(three, 13)) == 1.0
    assert rounding_of(np.resize(three, 12)) == 0.0
    assert rounding_of(white(1.0, 1)) == 0.0
    assert rounding_of(np.ones(COUNT)) == rounding_of(np.ones(1)) == 0.0


def test_a_force_that_changes_between_two_values_rounds_if_it_turns_twice() -> None:
    """A landing changes the force once, a lift-off once more: these are no steps of the read-out."""
    for changes, step_n in ((1, 0.0), (2, 0.0), (3, 0.0), (4, 0.8)):
        assert rounding_of(0.8 * (np.arange(COUNT) * (changes + 1) // COUNT % 2)) == step_n
    # Three values have a step as well, however seldom they change.
    assert rounding_of(np.repeat([0.0, 0.3, 0.2], COUNT)) == pytest.approx(0.1)


def test_the_noise_of_a_read_out_is_no_less_than_that_of_its_steps() -> None:
    quiet, loud = white(0.02, 2), white(0.02, 3)
    assert noise_of(quiet, 0.0) == pytest.approx(0.02, rel=0.1)
    assert noise_of(loud, 0.24) == pytest.approx(0.24 / math.sqrt(12.0), rel=1e-12)
    # Too few samples show no noise of their own.
    assert noise_of(quiet[: LEAST_SAMPLES - 1], 0.0) == 0.0
    assert noise_of(quiet[:LEAST_SAMPLES], 0.0) > 0.0


@pytest.mark.parametrize("count", [30, 1000, 30_000])
def test_white_noise_seldom_reaches_beyond_its_reach(count: int) -> None:
    beyond = [float(np.abs(white(0.5, seed, count)).max()) > reach_of(0.5, count) for seed in range(100)]
    assert sum(beyond) <= 3
    # And it comes near: a reach that is twice as long would hide a motion of that size.
    largest = max(float(np.abs(white(0.5, seed, count)).max()) for seed in range(100))
    assert largest > 0.8 * reach_of(0.5, count)


def test_the_reach_grows_with_the_noise_and_slowly_with_the_number_of_samples() -> None:
    assert reach_of(2.0, 100) == pytest.approx(2.0 * reach_of(1.0, 100), rel=1e-12)
    assert reach_of(1.0, 100) == pytest.approx(math.sqrt(2.0 * math.log(100.0)) + 1.0, rel=1e-12)
    assert reach_of(1.0, 0) == reach_of(1.0, 1) == reach_of(1.0, 2) < reach_of(1.0, 3)


def test_a_force_has_moved_by_what_noise_does_not_explain() -> None:
    ramp = np.linspace(0.0, 1.0, COUNT)
    assert moved_of(ramp, 0.0) == pytest.approx(1.0, rel=1e-12)
    assert moved_of(ramp, 0.05) == pytest.approx(1.0 - 2.0 * reach_of(0.05, COUNT), rel=1e-12)
    assert moved_of(ramp, 0.5) == 0.0
    assert all(moved_of(white(0.05, seed), 0.05) == 0.0 for seed in range(50))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_force_is_gone_where_its_later_half_goes_farther(sign: float) -> None:
    # It stands still for a share of the time and then goes its way evenly.
    for share, is_gone in ((0.1, True), (0.4, True), (0.0, False), (-0.4, False)):
        ramp = np.clip((np.arange(COUNT) / COUNT - max(share, 0.0)) / (1.0 - abs(share)), 0.0, 1.0)
        assert (gone_of(sign * ramp) > 0.0) is is_gone, share
    late = sign * np.where(np.arange(COUNT) < 0.8 * COUNT, 0.0, 1.0)
    assert gone_of(late + 7.0) == pytest.approx(1.0, rel=1e-9)
    # One that comes back is not, and neither is one that goes out and half of the way back.
    assert gone_of(sign * np.sin(np.linspace(0.0, math.pi, COUNT))) == pytest.approx(0.0, abs=1e-9)
    assert gone_of(sign * np.interp(np.arange(COUNT), [0, COUNT / 2, COUNT], [0.0, 1.0, 0.5])) == 0.0


@pytest.mark.parametrize("turns", [1.0, 5.0, 12.0])
def test_a_line_is_measured_from_peak_to_peak_whatever_its_phase_and_place(turns: float) -> None:
    angle = 2.0 * math.pi * turns * np.arange(COUNT) / (COUNT - 1)
    for phase in (0.0, 0.7, 1.6, 3.0):
        series = 3.0 + 0.15 * np.sin(angle + phase)
        assert line_n(series, turns) == pytest.approx(0.3, rel=2e-3)
        assert line_n(series, turns + 3.0) < 2e-3
    assert line_n(np.array([3.0]), turns) == 0.0


def test_messages_that_come_when_they_come_are_put_on_an_even_grid() -> None:
    time_s = 5.0 + np.arange(100) * 2e-3
    late_s = time_s.copy()
    late_s[50] += 1e-3
    values, period_s = even(late_s, 10.0 * late_s)
    assert period_s == pytest.approx(2e-3, rel=1e-9)
    assert values == pytest.approx(10.0 * time_s, rel=1e-12)
    # Where the times are even to a millionth of a period, the values stay as they are.
    for off, stays in ((0.5e-6, True), (2e-6, False)):
        nearly_s = time_s.copy()
        nearly_s[50] += off * 2e-3
        taken = np.where(np.arange(100) == 50, 1e6, 0.0)
        assert bool(even(nearly_s, taken)[0][50] == 1e6) is stays

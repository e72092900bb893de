"""Steps and noise of a read-out, and how far a force goes without them, on series that are made with known ones."""

import math

import numpy as np
import pytest

from telenano.analysis.read_out import (
    Noise,
    even,
    free_noise,
    noise_in,
    octaves_of,
    power_within,
    reach_of,
    rms,
    rounding_of,
    white_noise_of,
    white_share,
)
from telenano.analysis.verdict_thresholds import LEAST_SAMPLES, NOISE_AGREES

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


def pink(seed: int, count: int) -> np.ndarray:
    """Return noise with the same power in each octave down to a fourth of its inverse length."""
    lines = np.fft.rfft(white(1.0, seed, 4 * count))
    values = np.fft.irfft(lines / np.sqrt(np.maximum(np.arange(len(lines)), 1.0)))[:count]
    return np.asarray(values / values.std())


def test_the_octaves_of_a_series_and_the_means_that_are_left_are_the_series() -> None:
    values = np.cumsum(white(1.0, 4, 1000))
    octaves = list(octaves_of(values))
    assert sum(own for own, _ in octaves) + octaves[-1][1] == pytest.approx(values, abs=1e-9)
    # The means of the slowest are over a quarter to either side at most.
    assert len(octaves) == 7


@pytest.mark.parametrize("octave", [0, 1, 2, 3, 4])
def test_the_share_of_white_noise_in_an_octave_is_that_of_its_means(octave: int) -> None:
    own = next(own for k, (own, _) in enumerate(octaves_of(white(1.0, 5, 60_000))) if k == octave)
    assert rms(own) ** 2 == pytest.approx(white_share(octave), rel=0.06)


def test_noise_is_measured_in_the_longest_stretch_of_the_free_tip() -> None:
    noise = 0.02 * pink(1, 8000) + white(0.01, 2, 8000)
    measured = free_noise([noise[:70], noise])
    assert measured is not None and measured.samples == 8000
    assert measured.white_n == pytest.approx(0.012, rel=0.3)
    for octave, (own, _) in enumerate(octaves_of(noise)):
        told = measured.white_n**2 * white_share(octave) + measured.in_octave(octave)
        assert told == pytest.approx(rms(own) ** 2, rel=0.8), octave
    assert free_noise([noise[: 4 * LEAST_SAMPLES - 1]]) is None and free_noise([]) is None
    # A snap into contact in an eighth of it is passed over.
    snap = np.where(np.arange(8000) // 300 == 9, 1.0, 0.0)
    again = free_noise([noise + snap])
    assert again is not None and max(again.octaves_n2) < 2.0 * max(measured.octaves_n2)


def test_a_hold_has_no_more_white_noise_than_the_free_tip_but_that_of_its_steps() -> None:
    quiet = white(0.02, 2)
    assert noise_in(quiet, None, 0.0).white_n == pytest.approx(0.02, rel=0.1)
    assert noise_in(quiet, Noise(0.004, (1e-6,)), 0.0) == Noise(NOISE_AGREES * 0.004, (NOISE_AGREES**2 * 1e-6,))
    assert noise_in(quiet, None, 0.24).white_n == pytest.approx(0.4 * 0.24)
    # Too few samples show no noise of their own.
    assert noise_in(quiet[: LEAST_SAMPLES - 1], None, 0.0).white_n == 0.0


def test_chance_seldom_makes_noise_exceed_what_it_may() -> None:
    beyond = total = 0
    for seed in range(60):
        measured = free_noise([0.02 * pink(seed, 2000)])
        assert measured is not None
        hold = 0.02 * pink(1000 + seed, 4000)
        noise = noise_in(hold, measured, 0.0)
        for octave, (own, _) in enumerate(octaves_of(hold)):
            total += 1
            beyond += rms(own[:400]) ** 2 > power_within(noise, octave, 400)[1]
    assert beyond <= 0.01 * total, (beyond, total)


def test_bursts_and_lines_are_no_white_noise() -> None:
    bare = white(0.02, 3)
    swing = np.sin(np.arange(COUNT))
    assert white_noise_of(bare + swing) == pytest.approx(0.02, rel=0.2)


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

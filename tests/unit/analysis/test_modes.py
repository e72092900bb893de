"""Modes of a series: noise alone has none, and a line that is larger than noise makes is found."""

import math

import numpy as np
import pytest

from telenano.analysis.modes import averaged, fitted
from telenano.analysis.read_out import octaves_of, rms, white_share
from telenano.analysis.verdict_thresholds import LINE_OVER_NOISE

DRAWS = 100


def white(seed: int, count: int) -> np.ndarray:
    return np.random.Generator(np.random.PCG64(seed)).standard_normal(count)


def pink(seed: int, count: int) -> np.ndarray:
    """Return a part of 1/f noise of unit variance, which turns no more slowly than in four such parts."""
    lines = np.fft.rfft(white(seed, 4 * count))
    values = np.fft.irfft(lines / np.sqrt(np.maximum(np.arange(len(lines)), 1.0)))
    return values[:count] / values.std()


def density_n(values: np.ndarray) -> float:
    """Return the standard deviation of white noise with the density of the slowest octave of a series."""
    octaves = [rms(own) for own, _ in octaves_of(values)]
    return octaves[-1] / math.sqrt(white_share(len(octaves) - 1))


@pytest.mark.parametrize("count", [36, 60, 100])
def test_white_noise_alone_has_no_mode_in_a_short_series_either(count: int) -> None:
    """An octave of few lines has little power by chance: with that alone seven in a hundred had a mode."""
    found = [seed for seed in range(2000, 2000 + DRAWS) if fitted(white(seed, count), 1.0 / count, 1e-9, 1.0).modes]
    assert len(found) <= 0.02 * DRAWS


@pytest.mark.parametrize("count", [60, 250])
def test_few_series_of_pink_noise_have_a_mode(count: int) -> None:
    found = [
        seed
        for seed in range(3000, 3000 + DRAWS)
        if fitted(pink(seed, count), 1.0 / count, 1e-9, density_n(pink(seed, count))).modes
    ]
    # A mode alone is no verdict: the size of the motion is asked before.
    assert len(found) <= 0.2 * DRAWS


@pytest.mark.parametrize("count", [60, 250])
def test_a_line_is_found_that_is_twice_as_large_as_noise_makes_it(count: int) -> None:
    """The size of a line whose power is LINE_OVER_NOISE of that of the noise, twice."""
    missed = []
    for seed in range(4000, 4000 + DRAWS // 4):
        size = 2.0 * 2.0 * math.sqrt(2.0 * LINE_OVER_NOISE / count) / math.sqrt(2.0)
        swing = size * np.cos(2.0 * np.pi * 5.3 * np.arange(count) / (count - 1.0))
        modes = fitted(white(seed, count) + swing, 1.0 / count, 1e-9, 1.0).modes
        if not any(abs(mode.frequency_hz * (count - 1.0) / count - 5.3) < 0.7 for mode in modes):
            missed.append(seed)
    assert len(missed) <= 1, missed


@pytest.mark.parametrize(("growth", "turns"), [(-2.0, 3.0), (0.0, 1.4), (1.5, 0.0), (-1.0, 0.0), (0.7, 6.0)])
def test_the_growth_and_the_ends_of_a_mode_are_those_of_its_exponential(growth: float, turns: float) -> None:
    times = np.linspace(0.0, 1.0, 200)
    swing = 0.3 * np.exp(growth * times) * np.cos(2.0 * math.pi * turns * times)
    (mode,) = fitted(1.0 + swing, 1.0 / 199.0, 1e-9, 0.0).modes
    assert (mode.growth_per_s, mode.frequency_hz) == pytest.approx((growth, turns), abs=1e-3)
    if turns >= 0.5:
        assert mode.begin_n == pytest.approx(0.6, rel=1e-3)
        assert mode.end_n == pytest.approx(0.6 * math.exp(growth), rel=1e-3)


def test_means_over_blocks_are_no_fewer_than_asked_and_end_with_the_series() -> None:
    means, block = averaged(np.arange(1003.0), 96)
    assert (len(means), block) == (100, 10)
    assert means[-1] == pytest.approx(np.mean(np.arange(993.0, 1003.0)))
    assert averaged(np.arange(50.0), 96)[1] == 1

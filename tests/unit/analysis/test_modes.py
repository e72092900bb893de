"""Modes of a series: noise alone has none, and a line that is larger than noise makes is found."""

import math

import numpy as np
import pytest

from telenano.analysis.modes import LINE_OVER_NOISE, fitted, line_level

DRAWS = 100


def white(seed: int, count: int) -> np.ndarray:
    return np.random.Generator(np.random.PCG64(seed)).standard_normal(count)


def pink(seed: int, count: int) -> np.ndarray:
    """Return a part of 1/f noise of unit variance, which turns no more slowly than in four such parts."""
    lines = np.fft.rfft(white(seed, 4 * count))
    values = np.fft.irfft(lines / np.sqrt(np.maximum(np.arange(len(lines)), 1.0)))
    return values[:count] / values.std()


@pytest.mark.parametrize("count", [36, 60, 100])
def test_white_noise_alone_has_no_mode_in_a_short_series_either(count: int) -> None:
    """An octave of few lines has little power by chance: with that alone seven in a hundred had a mode."""
    found = [seed for seed in range(2000, 2000 + DRAWS) if fitted(white(seed, count), 1.0 / count, 1e-9).modes]
    assert len(found) <= 0.02 * DRAWS


@pytest.mark.parametrize("count", [60, 250])
def test_few_series_of_pink_noise_have_a_mode(count: int) -> None:
    found = [seed for seed in range(3000, 3000 + DRAWS) if fitted(pink(seed, count), 1.0 / count, 1e-9).modes]
    assert len(found) <= 0.06 * DRAWS


@pytest.mark.parametrize("count", [60, 250])
@pytest.mark.parametrize("make", [white, pink])
def test_a_line_is_found_that_is_twice_as_large_as_noise_makes_it(make: object, count: int) -> None:
    """The size of a line whose power is LINE_OVER_NOISE of that of the noise, twice."""
    missed = []
    for seed in range(4000, 4000 + DRAWS // 4):
        noise, turns = make(seed, count), 5.3  # type: ignore[operator]
        level = line_level(noise, 2.0 * math.pi * turns, True)
        size = 2.0 * 2.0 * math.sqrt(2.0 * LINE_OVER_NOISE * level / count) / math.sqrt(2.0)
        swing = size * np.cos(2.0 * np.pi * turns * np.arange(count) / (count - 1.0))
        modes = fitted(noise + swing, 1.0 / count, 1e-9).modes
        if not any(abs(mode.frequency_hz * (count - 1.0) / count - turns) < 0.7 for mode in modes):
            missed.append(seed)
    assert len(missed) <= 1, missed


@pytest.mark.parametrize("count", [60, 250, 1000])
def test_the_level_of_a_line_is_the_power_of_white_noise_or_a_little_more(count: int) -> None:
    levels = np.array(
        [
            [line_level(white(seed, count), 2.0 * math.pi * turns, True) for turns in (2.0, 5.0, 0.3 * count)]
            for seed in range(200)
        ]
    )
    assert np.median(levels) == pytest.approx(1.0, rel=0.5)
    assert levels.min() > 0.3

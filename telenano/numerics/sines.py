"""A band of noise as a sum of sines, spread evenly over the logarithm of the frequency, of equal amplitude.

    band = sines_of(seed, 1, 0.05, 13.0)
    value = sine_noise(band, 0.03, time_s)

In each octave of the band it has the same power, so that its density falls as 1/f. It remembers nothing: its value is
a function of the time.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

_SINES = 48


class Sines(NamedTuple):
    """Angular frequencies [rad/s] and phases."""

    rates: tuple[float, ...]
    phases: tuple[float, ...]


@lru_cache(maxsize=16)
def sines_of(seed: int, stream: int, first_hz: float, last_hz: float) -> Sines:
    """Return frequencies and phases between two frequencies [Hz], which seed and stream decide."""
    random = np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, stream]))
    low, high = sorted((first_hz, last_hz))
    # Each lies somewhere in its part of the band: an even comb would have a period. Powers and sines are those of the C
    # library, one after the other: NumPy's own depend on the instructions of the processor.
    places = [(i + share) / _SINES for i, share in enumerate(random.random(_SINES).tolist())]
    rates = tuple(2.0 * math.pi * low * math.pow(high / low, place) for place in places)
    return Sines(rates, tuple(2.0 * math.pi * share for share in random.random(_SINES).tolist()))


def sine_noise(sines: Sines, rms: float, time_s: float) -> float:
    """Return their sum at a time [s] with a root mean square of rms."""
    amplitude = rms * math.sqrt(2.0 / _SINES)
    return amplitude * sum(
        math.sin(rate * time_s + phase) for rate, phase in zip(sines.rates, sines.phases, strict=True)
    )

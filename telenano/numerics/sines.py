"""Band-limited noise as a sum of sines of equal amplitude, spread evenly over the logarithm of the frequency.

    band = sines_of(seed, 1, 0.05, 13.0)
    value = sine_noise(band, 0.03, time_s)

The power in each octave of the band is the same, so the spectral density falls as 1/f. The noise has no state: its
value is a function of time.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

_SINES = 48


class Sines(NamedTuple):
    """Angular frequencies [rad/s] and phases [rad]."""

    rates: tuple[float, ...]
    phases: tuple[float, ...]


@lru_cache(maxsize=16)
def sines_of(seed: int, stream: int, first_hz: float, last_hz: float) -> Sines:
    """Return random frequencies in a band [Hz] and random phases, determined by seed and stream."""
    random = np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, stream]))
    low, high = sorted((first_hz, last_hz))
    # Each frequency is random within its part of the band, because an even comb would be periodic. Powers and sines use
    # the C library one by one, because those of NumPy depend on the instruction set of the processor.
    places = [(i + share) / _SINES for i, share in enumerate(random.random(_SINES).tolist())]
    rates = tuple(2.0 * math.pi * low * math.pow(high / low, place) for place in places)
    return Sines(rates, tuple(2.0 * math.pi * share for share in random.random(_SINES).tolist()))


def sine_noise(sines: Sines, rms: float, time_s: float) -> float:
    """Return the noise at a time [s], with root mean square `rms`, in the unit of `rms`."""
    amplitude = rms * math.sqrt(2.0 / _SINES)
    return amplitude * sum(
        math.sin(rate * time_s + phase) for rate, phase in zip(sines.rates, sines.phases, strict=True)
    )

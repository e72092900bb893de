"""What the read-out of a force adds to it: steps, white noise, and noise that was measured octave by octave.

A series is taken apart into octaves of time: each is the difference of two means, over widths of 1, 2, 4 ... samples,
so that all of them together are the series. Noise is measured by the same means in the tip that touches nothing
(`free_noise`), so what a hold has to exceed is known octave by octave without a model of the noise. Sums follow the
order of time, so that no result depends on the kernel that a library chooses for a processor.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.verdict_thresholds import (
    LEAST_SAMPLES,
    LEAST_TURNS,
    MEASURED_ERRORS,
    NOISE_AGREES,
)

Series = npt.NDArray[np.float64]


class Noise(NamedTuple):
    """Noise of a read-out: standard deviation of its white part [N], and the power of the rest by octave [N^2].

    Octave k is that of means over 2^k samples; slower ones have no more power than the last of the list. samples: the
    number of samples by which it was measured; infinite where it is stated.
    """

    white_n: float
    octaves_n2: tuple[float, ...]
    samples: float = math.inf

    def in_octave(self, octave: int) -> float:
        """Return the power of the part that is not white in an octave [N^2]."""
        return self.octaves_n2[min(octave, len(self.octaves_n2) - 1)] if self.octaves_n2 else 0.0


def total(values: Series) -> float:
    """Return the sum in the order of the samples, which is the same on every processor."""
    return float(np.cumsum(values)[-1]) if len(values) else 0.0


def rms(values: Series) -> float:
    """Return the root mean square, summed in the order of the samples."""
    return math.sqrt(total(values * values) / max(1, len(values)))


def centred(values: Series) -> Series:
    """Return a series without its mean, which is summed in the order of the samples; shape (n,), n >= 1."""
    return values - total(values) / len(values)


def white_share(octave: int) -> float:
    """Return the share of the power of white noise that is in an octave [1]: the squares of its weights."""
    return (1.0 + 1.25 / 4.0**octave) / (6.0 * 2.0**octave)


def octaves_of(values: Series) -> Iterator[tuple[Series, Series]]:
    """Give each octave of a series and the means that are left, the fastest octave first, each of shape (n,).

    The slowest means are over a quarter of the series or less, to either side; the ends are mirrored.
    """
    now, width = values, 1
    while 8 * width <= len(values):
        wide = np.concatenate([now[width - 1 :: -1], now, now[: -width - 1 : -1]])
        after = 0.5 * now + 0.25 * (wide[: -2 * width] + wide[2 * width :])
        yield now - after, after
        now, width = after, 2 * width


def white_noise_of(values: Series) -> float:
    """Return the standard deviation of white noise in a series that is smooth except for bursts or lines.

    The series has shape (n,), n >= 16. The result is the smaller of two estimates: from the median of the third
    differences, which bursts do not raise, and from the median of the upper half of the spectrum, which lines do not.
    """
    third = np.abs(np.diff(values, 3))
    in_time = float(np.median(third)) / 0.6745 / math.sqrt(20.0)
    if in_time == 0.0:
        return 0.0
    count = len(values)
    bare = values - np.interp(np.arange(count), [0, count - 1], [values[0], values[-1]])
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * (np.arange(count) + 0.5) / count)
    power = np.abs(np.fft.rfft(bare * window)) ** 2 / total(window * window)
    return min(in_time, math.sqrt(float(np.median(power[len(power) // 2 :])) / math.log(2.0)))


def free_noise(stretches: list[Series]) -> Noise | None:
    """Return the noise of a tip that touches nothing, from its force in the longest stretch [N]; None if it is short.

    An octave counts as measured where its means are no longer than a sixteenth of the stretch; slower noise has no more
    power than the slowest of these, as 1/f noise has, and a slower octave no less than half of the next faster one.
    """
    longest = max(stretches, key=len, default=np.empty(0))
    if len(longest) < 4 * LEAST_SAMPLES:
        return None
    white = white_noise_of(longest)
    powers: list[float] = []
    for octave, (own, _) in enumerate(octaves_of(longest)):
        if 16 * 2**octave > len(longest):
            break
        # A snap into contact or a blow lasts for a part of the stretch: the median of eight parts passes it over.
        parts = [total(part * part) / len(part) for part in np.array_split(own, 8)]
        coloured = max(float(np.median(parts)) - white * white * white_share(octave), 0.0)
        powers.append(max(coloured, 0.5 * powers[-1] if powers else 0.0))
    return Noise(white, tuple(powers), len(longest))


def noise_in(values: Series, free: Noise | None, step_n: float) -> Noise:
    """Return the noise that a hold may have: what was measured in the free tip, and no more white noise than it has.

    Without a measurement only the white noise of the hold itself is noise. A step that the read-out rounds to is
    a part of the white noise, as it is where it flickers for a fifth of the time.
    """
    own = white_noise_of(values) if len(values) >= LEAST_SAMPLES else 0.0
    if free is not None:
        own = min(own, NOISE_AGREES * free.white_n)
    powers = () if free is None else tuple(NOISE_AGREES**2 * power for power in free.octaves_n2)
    return Noise(max(own, 0.4 * step_n), powers, math.inf if free is None else free.samples)


def power_within(noise: Noise, octave: int, samples: float) -> tuple[float, float]:
    """Return the mean power of noise in an octave of a stretch of samples, and what it exceeds by chance [N^2]."""
    mean = noise.white_n**2 * white_share(octave) + noise.in_octave(octave)
    seen = 1.0 / (2.0 ** (octave + 1) / samples + 2.0 ** min(octave + 1, len(noise.octaves_n2)) / noise.samples)
    return mean, mean * (1.0 + MEASURED_ERRORS * math.sqrt(2.0 / seen) + min(4.0 / seen, 8.0))


def rounding_of(values: Series) -> float:
    """Return the step of a read-out that rounds [N]; 0 of one that does not.

    Two values that do not alternate show no step: a tip that lands and rests changes its force once.
    """
    steps, count = np.abs(np.diff(values)), len(np.unique(values))
    moved = steps[steps > 0.0]
    is_landing = count <= 2 and len(moved) < 2.0 * LEAST_TURNS
    return float(moved.min()) if not is_landing and count < len(values) / 4 else 0.0


def reach_of(noise_n: float, count: int) -> float:
    """Return what white noise of a standard deviation [N] reaches to one side in a number of samples [N]."""
    return noise_n * (math.sqrt(2.0 * math.log(max(count, 2))) + 1.0)


def even(time_s: Series, force_n: Series) -> tuple[Series, float]:
    """Return the force on an even grid of as many samples, and its period [s]; messages come when they come."""
    grid = np.linspace(time_s[0], time_s[-1], len(time_s))
    period_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if float(np.abs(time_s - grid).max()) <= 1e-6 * period_s:
        return np.asarray(force_n, dtype=np.float64), period_s
    return np.interp(grid, time_s, force_n), period_s

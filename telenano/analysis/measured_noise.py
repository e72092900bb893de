"""Noise of a read-out, measured octave by octave in the tip that touches nothing.

A series is taken apart into octaves of time: each is the difference of two means, over widths of 1, 2, 4 ... samples,
so that all of them together are the series. So what a hold has to exceed is known without a model of the noise. Sums
follow the order of time, so that no result depends on the kernel that a library chooses for a processor.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.modes import LEAST_SAMPLES, noise_floor, rms
from telenano.analysis.verdict_thresholds import MEASURED_ERRORS

Series = npt.NDArray[np.float64]


class Noise(NamedTuple):
    """Noise of a read-out: standard deviation of its white part [N], and the power of the rest by octave [N^2].

    Octave k is that of means over 2^k samples; slower ones have no more power than the last of the list. samples: the
    number of samples by which it was measured; infinite where it is stated.
    """

    white_n: float
    octaves_n2: tuple[float, ...]
    samples: float = math.inf

    def within(self, octave: int, samples: float) -> tuple[float, float]:
        """Return the mean power in an octave of a stretch of samples, and what it exceeds by chance [N^2]."""
        coloured = self.octaves_n2[min(octave, len(self.octaves_n2) - 1)] if self.octaves_n2 else 0.0
        mean = self.white_n**2 * _white_share(octave) + coloured
        seen = 1.0 / (2.0 ** (octave + 1) / samples + 2.0 ** min(octave + 1, len(self.octaves_n2)) / self.samples)
        return mean, mean * (1.0 + MEASURED_ERRORS * math.sqrt(2.0 / seen) + min(4.0 / seen, 8.0))


def _white_share(octave: int) -> float:
    """Return the share of the power of white noise that is in an octave [1]: the squares of its weights."""
    return (1.0 + 1.25 / 4.0**octave) / (6.0 * 2.0**octave)


def octaves_of(values: Series) -> Iterator[Series]:
    """Give each octave of a series, the fastest first, each of shape (n,); what is slower than all of them is left off.

    The slowest means are over a quarter of the series or less, to either side; the ends are mirrored.
    """
    now, width = values, 1
    while 8 * width <= len(values):
        wide = np.concatenate([now[width - 1 :: -1], now, now[: -width - 1 : -1]])
        after = 0.5 * now + 0.25 * (wide[: -2 * width] + wide[2 * width :])
        yield now - after
        now, width = after, 2 * width


def free_noise(stretches: list[Series]) -> Noise | None:
    """Return the noise of a tip that touches nothing, from its force in the longest stretch [N]; None if it is short.

    An octave counts as measured where its means are no longer than a sixteenth of the stretch; slower noise has no more
    power than the slowest of these, as 1/f noise has, and a slower octave no less than half of the next faster one.
    """
    longest = max(stretches, key=len, default=np.empty(0))
    if len(longest) < 4 * LEAST_SAMPLES:
        return None
    white = noise_floor(longest)
    powers: list[float] = []
    for octave, own in enumerate(octaves_of(longest)):
        if 16 * 2**octave > len(longest):
            break
        # A snap into contact or a blow lasts for a part of the stretch: the median of eight parts passes it over.
        middle = float(np.median([rms(part) ** 2 for part in np.array_split(own, 8)]))
        powers.append(max(middle - white * white * _white_share(octave), 0.5 * powers[-1] if powers else 0.0))
    return Noise(white, tuple(powers), len(longest))

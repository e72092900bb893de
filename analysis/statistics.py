"""The interval of a mean of samples that follow one another."""

import math

import numpy as np
import numpy.typing as npt

from analysis.intervals import DEVIATIONS

_FEWEST_BLOCKS = 8


def correlated_half_width(values: npt.NDArray[np.float64]) -> float | None:
    """Return half the interval of 95 % of the mean of samples that follow one another, which may be correlated.

    By blocks after H. Flyvbjerg and H. G. Petersen (J. Chem. Phys. 91 (1989) 461): the means of 8, 16, 32 … parts are
    taken for independent, and the widest of the intervals counts. It is too narrow where the correlation lasts longer
    than a sixtieth of the time of all samples.

    Args:
        values: The samples in the order of time, shape (n,); None is returned for fewer than 8.
    """
    half_widths, count = [], _FEWEST_BLOCKS
    while count <= values.size:
        means = values[: values.size // count * count].reshape(count, -1).mean(axis=1)
        half_widths.append(_student(count - 1) * float(np.std(means, ddof=1)) / math.sqrt(count))
        count *= 2
    return max(half_widths, default=None)


def _student(freedom: int) -> float:
    """Return Student's t that 2.5 % exceed, within 1 % from 7 degrees of freedom on (Abramowitz and Stegun 26.7.5)."""
    z = DEVIATIONS
    return z + (z**3 + z) / (4.0 * freedom) + (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / (96.0 * freedom**2)

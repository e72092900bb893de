"""What repeated values have in common: mean, deviation and interval.

The interval of a mean is Student's, that of a share Wilson's; both are meant to have the true value in 95 of 100
repetitions of everything that was measured.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from analysis.intervals import DEVIATIONS, half_width, wilson

CONFIDENCE = 0.95
_FEWEST_BLOCKS = 8


class Statistic(NamedTuple):
    """Number of values, their mean, standard deviation (n - 1), and the ends of the interval of the mean.

    As text it is `mean ± deviation [low, high]`, of a share without the deviation.
    """

    n: int
    mean: float
    deviation: float | None
    low: float | None
    high: float | None

    def __str__(self) -> str:
        spread = "" if self.deviation is None else f" ± {self.deviation:.2g}"
        between = "" if self.low is None or self.high is None else f" [{self.low:.3g}, {self.high:.3g}]"
        return f"{self.mean:.3g}{spread}{between}"


def statistic(values: Sequence[float]) -> Statistic:
    """Return the statistic of one or more numbers; one number has neither deviation nor interval."""
    n, mean = len(values), math.fsum(values) / len(values)
    if n < 2:
        return Statistic(n, mean, None, None, None)
    deviation = math.sqrt(math.fsum((value - mean) ** 2 for value in values) / (n - 1))
    half = half_width(deviation, n, CONFIDENCE)
    return Statistic(n, mean, deviation, mean - half, mean + half)


def share(count: int, of: int) -> Statistic:
    """Return the statistic of a share: 0 <= count <= of, of > 0. It has no deviation."""
    return Statistic(of, count / of, None, *wilson(count, of))


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

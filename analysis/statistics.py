"""What repeated values have in common: mean, deviation and interval.

The interval of a mean is Student's, that of a share Wilson's; both are meant to have the true value in 95 of 100
repetitions of everything that was measured.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from analysis.intervals import half_width, wilson
from analysis.mean_interval import mean_half_width as mean_half_width

CONFIDENCE = 0.95


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

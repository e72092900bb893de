"""Confidence intervals of counted shares, and of means."""

import math
from collections.abc import Sequence
from functools import lru_cache

# number of standard deviations about the mean that contains 95 % of a normal distribution
DEVIATIONS = 1.959964


def half_width(deviation: float, count: int, confidence: float = 0.95) -> float:
    """Return half the confidence interval of a mean by Student's t, in the unit of the deviation.

    Args:
        deviation: The standard deviation of the values, by n - 1.
        count: The number of values, 2 or more.
        confidence: The probability that an interval contains the true mean.
    """
    return student(count - 1, confidence) * deviation / math.sqrt(count)


def with_error(value: float, interval: Sequence[float] | None) -> str:
    """Return a figure to three decimals, or with ± half its interval and to two digits of that, if that is coarser."""
    half = 0.5 * (interval[1] - interval[0]) if interval else 0.0
    if half < 0.0005:
        return f"{value:.3f}"
    places = max(0, 1 - math.floor(math.log10(half)))
    return f"{value:.{places}f} ± {half:.{places}f}"


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return the interval of a share after E. B. Wilson (J. Am. Stat. Assoc. 22 (1927) 209), of 95 %.

    Args:
        successes: The number of successes, 0 to trials.
        trials: The number of trials.
    """
    if trials == 0:
        return 0.0, 1.0
    share, z2 = successes / trials, DEVIATIONS * DEVIATIONS
    middle = (share + 0.5 * z2 / trials) / (1.0 + z2 / trials)
    half = DEVIATIONS / (1.0 + z2 / trials) * math.sqrt(share * (1.0 - share) / trials + 0.25 * z2 / trials**2)
    # The ends are exactly 0 and 1, where rounding would leave a small error.
    return (middle - half if successes else 0.0), (middle + half if successes < trials else 1.0)


@lru_cache(maxsize=1024)
def student(freedom: int, confidence: float = 0.95) -> float:
    """Return Student's t: a share `confidence` of the distribution lies between -t and t.

    The share is the finite series of M. Abramowitz and I. Stegun (26.7.3 and 26.7.4) in theta = atan(t/sqrt(freedom)),
    and t is found by bisection: a rig has no SciPy.

    Args:
        freedom: The degrees of freedom, 1 or more.
        confidence: The share, 0 to below 1.

    Raises:
        ValueError: The degrees of freedom or the share are out of range.
    """
    if freedom < 1 or not 0.0 <= confidence < 1.0:
        raise ValueError(f"Student's t of {freedom} degrees of freedom and a share of {confidence} does not exist")
    low, high = 0.0, 0.5 * math.pi
    while low < (theta := 0.5 * (low + high)) < high:
        low, high = (theta, high) if _share_within(theta, freedom) < confidence else (low, theta)
    return math.sqrt(freedom) * math.tan(low)


def _share_within(theta: float, freedom: int) -> float:
    """Return the share of Student's distribution within sqrt(freedom) tan(theta) of its middle."""
    cosine, is_odd = math.cos(theta), freedom % 2
    term = cosine if is_odd else 1.0
    total = term if freedom > 1 else 0.0
    for power in range(2 + is_odd, freedom - 1, 2):
        term *= (power - 1.0) / power * cosine * cosine
        total += term
    series = math.sin(theta) * total
    return 2.0 / math.pi * (theta + series) if is_odd else series

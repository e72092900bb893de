"""Intervals of shares that were counted, and of means."""

import math
from collections.abc import Sequence

# a normal number is within so many standard deviations 95 times in 100
DEVIATIONS = 1.959964


def half_width(deviation: float, count: int, confidence: float = 0.95) -> float:
    """Return half the interval of a mean by Student's t.

    Args:
        deviation: The standard deviation of the values, by n - 1.
        count: How many values there are, 2 or more.
        confidence: How often an interval is meant to have the true mean in it.
    """
    from scipy.stats import t

    return float(t.ppf(0.5 + 0.5 * confidence, count - 1) * deviation / math.sqrt(count))


def with_error(value: float, interval: Sequence[float] | None) -> str:
    """Return a figure to three places, or to two digits of half its interval and with it, where that is coarser."""
    half = 0.5 * (interval[1] - interval[0]) if interval else 0.0
    if half < 0.0005:
        return f"{value:.3f}"
    places = max(0, 1 - math.floor(math.log10(half)))
    return f"{value:.{places}f} ± {half:.{places}f}"


def wilson(successes: int, trials: int) -> tuple[float, float]:
    """Return the interval of a share after E. B. Wilson (J. Am. Stat. Assoc. 22 (1927) 209), of 95 %.

    Args:
        successes: How many succeeded, 0 to trials.
        trials: How many there were.
    """
    if trials == 0:
        return 0.0, 1.0
    share, z2 = successes / trials, DEVIATIONS * DEVIATIONS
    middle = (share + 0.5 * z2 / trials) / (1.0 + z2 / trials)
    half = DEVIATIONS / (1.0 + z2 / trials) * math.sqrt(share * (1.0 - share) / trials + 0.25 * z2 / trials**2)
    # the ends are exact where rounding would leave a bit
    return (middle - half if successes else 0.0), (middle + half if successes < trials else 1.0)


def student(freedom: int) -> float:
    """Return Student's t that 2.5 % exceed, within 1 % from 7 degrees of freedom on (Abramowitz and Stegun 26.7.5)."""
    z = DEVIATIONS
    return z + (z**3 + z) / (4.0 * freedom) + (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / (96.0 * freedom**2)

"""Statistics of tests: corrected p values, differences and effect sizes with their intervals."""

import math
import warnings
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from telenano.analysis import half_width

CORRECTIONS = ("holm", "bonferroni", "fdr_bh", "none")
Matrix = npt.NDArray[np.float64]
# Bound of the search for noncentrality parameters, beyond any real experiment.
_FARTHEST = 2.0**24

# Difference, ends of its interval, degrees of freedom, p, Hedges' g, ends of its interval.
Compared = tuple[float, float, float, float, float, float, float, float]


def corrected(ps: Sequence[float], correction: str) -> list[float]:
    """Return p values corrected for multiple comparisons, in their order.

    Bonferroni; S. Holm, Scand. J. Stat. 6 (1979) 65; Y. Benjamini and Y. Hochberg, J. R. Stat. Soc. B 57 (1995) 289.
    """
    from statsmodels.stats.multitest import multipletests

    if correction == "none" or not ps:
        return list(ps)
    return [float(p) for p in multipletests(ps, method=correction)[1]]


def mean_interval(values: Matrix, confidence: float = 0.95) -> tuple[float, float, float]:
    """Return the mean of participants' values with its interval by Student's t; the ends are NaN for a single value."""
    mean, count = float(np.mean(values)), len(values)
    if count < 2:
        return mean, math.nan, math.nan
    half = half_width(float(np.std(values, ddof=1)), count, confidence)
    return mean, mean - half, mean + half


def compared(left: Matrix, right: Matrix, paired: Matrix | None, confidence: float) -> Compared | None:
    """Compare two levels over participants; None if there are fewer than two of them or the deviation is 0.

    Args:
        left: The means of participants at one level.
        right: Those at the other level.
        paired: The differences of participants who have both; None if the factor varies between participants.
        confidence: The confidence of the intervals.
    """
    from scipy import stats

    if min(len(part) for part in ((left, right) if paired is None else (paired,))) < 2:
        return None
    if paired is not None:
        deviation, size, difference = float(paired.std(ddof=1)), float(len(paired)), float(paired.mean())
    else:
        # Hedges' g uses the pooled deviation.
        rest = len(left) - 1, len(right) - 1
        deviation = math.sqrt(float(left.var(ddof=1) * rest[0] + right.var(ddof=1) * rest[1]) / sum(rest))
        size, difference = len(left) * len(right) / (len(left) + len(right)), float(left.mean() - right.mean())
    if deviation <= 0.0:
        return None
    # Student's paired test, or Welch's; one side may be constant, which SciPy warns about.
    with warnings.catch_warnings(action="ignore"):
        test = stats.ttest_ind(left, right, equal_var=False) if paired is None else stats.ttest_1samp(paired, 0.0)
    df, ends = float(test.df), test.confidence_interval(confidence)
    # L. V. Hedges, J. Educ. Stat. 6 (1981) 107: the deviation of few values is too small on average.
    small = 1.0 - 3.0 / (4.0 * df - 1.0)
    t = difference / deviation * math.sqrt(size)
    low, high = _noncentral(lambda centre: float(stats.nct.cdf(t, df, centre)), -math.inf, t, confidence)
    scale = small / math.sqrt(size)
    return difference, float(ends.low), float(ends.high), df, float(test.pvalue), t * scale, low * scale, high * scale


def partial_eta2(f: float, df1: float, df2: float, confidence: float = 0.95) -> tuple[float, float, float]:
    """Return partial η² of an F test with its interval, by the noncentral F distribution.

    M. J. Smithson, Educ. Psychol. Meas. 61 (2001) 605.
    """
    from scipy import stats

    low, high = _noncentral(lambda centre: float(stats.ncf.cdf(f, df1, df2, centre)), 0.0, df1 * f, confidence)
    shares = [centre / (centre + df1 + df2 + 1.0) for centre in (low, high)]
    return df1 * f / (df1 * f + df2), shares[0], shares[1]


def _noncentral(
    chance_below: Callable[[float], float], floor: float, start: float, confidence: float
) -> tuple[float, float]:
    """Return the noncentrality parameters for which the statistic is the upper and the lower quantile.

    Args:
        chance_below: Returns the probability of a lesser statistic; it falls as its argument, the parameter, grows.
        floor: The least possible parameter.
        start: Start of the search.
        confidence: The confidence of the interval.
    """
    from scipy.optimize import brentq

    def chance(centre: float) -> float:
        below = chance_below(centre)
        # Far from the statistic SciPy's series does not converge; there the probability is 1 or 0.
        return (1.0 if centre < start else 0.0) if math.isnan(below) else below

    def centre_of(quantile: float) -> float:
        low = high = start
        step = 1.0
        while low > floor and chance(low) < quantile and step < _FARTHEST:
            low, step = max(low - step, floor), 2.0 * step
        if chance(low) < quantile:
            return low
        step = 1.0
        while chance(high) > quantile and step < _FARTHEST:
            high, step = high + step, 2.0 * step
        return float(brentq(lambda centre: chance(centre) - quantile, low, high)) if step < _FARTHEST else high

    tail = 0.5 - 0.5 * confidence
    return centre_of(1.0 - tail), centre_of(tail)

"""Sensitivity d' and criterion c of signal detection, with intervals.

Rates are (k + 1/2) / (n + 1), so that none is 0 or 1 (M. J. Hautus, Behav. Res. Methods 27 (1995) 46). Intervals assume
a normal distribution with the variance of V. Gourevitch and E. Galanter (Psychometrika 32 (1967) 25). For a choice of
two intervals, d' is divided by the square root of 2 (N. A. Macmillan and C. D. Creelman, Detection Theory, 2nd ed.
(2005), chapter 7), and c is the preference: below 0 for the first interval, above it for the second.
"""

import math
from statistics import NormalDist
from typing import NamedTuple

_NORMAL = NormalDist()


class Detection(NamedTuple):
    """Sensitivity and criterion with their intervals, and the counts behind them.

    Args:
        d_prime: The sensitivity.
        d_prime_low: The lower end of its interval.
        d_prime_high: The upper end.
        criterion: The criterion; 0 is no preference, above it "yes" is rarer.
        criterion_low: The lower end of its interval.
        criterion_high: The upper end.
        signals: Number of trials with the signal, or with it first.
        others: Number of other trials.
    """

    d_prime: float
    d_prime_low: float
    d_prime_high: float
    criterion: float
    criterion_low: float
    criterion_high: float
    signals: int
    others: int


def detection(
    hits: int, signals: int, false_alarms: int, others: int, *, of_two: bool, confidence: float = 0.95
) -> Detection:
    """Return sensitivity and criterion.

    Args:
        hits: Number of answers yes (or first) to a signal (that came first).
        signals: Number of signals (that came first).
        false_alarms: Number of answers yes (or first) to no signal (or one that came second).
        others: Number of trials without a signal (or with it second).
        of_two: Whether it is a choice of two intervals.
        confidence: The confidence of the intervals.
    """
    scale, variance, places = (math.sqrt(0.5) if of_two else 1.0), 0.0, []
    for count, number in ((hits, signals), (false_alarms, others)):
        rate = (count + 0.5) / (number + 1.0)
        places.append(_NORMAL.inv_cdf(rate))
        variance += rate * (1.0 - rate) / ((number + 1.0) * _NORMAL.pdf(places[-1]) ** 2)
    half = _NORMAL.inv_cdf(0.5 + 0.5 * confidence) * math.sqrt(variance)
    d_prime, criterion = scale * (places[0] - places[1]), -0.5 * (places[0] + places[1])
    ends = d_prime - scale * half, d_prime + scale * half
    return Detection(d_prime, *ends, criterion, criterion - 0.5 * half, criterion + 0.5 * half, signals, others)

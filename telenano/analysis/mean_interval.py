"""Confidence interval of the mean of a record with correlated samples, or none.

    from telenano.analysis.mean_interval import mean_half_width
    half = mean_half_width(ratios)          # None: this record does not show how well its mean is known

The mean of a window differs from that of a longer record by the slow parts of the signal. So an interval needs an
estimate of the spectrum at zero frequency, which a window contains only if its spectrum is flat below some frequency of
several cycles per window. The tremor of a hand with 1/f or 1/f^2 is never flat there, nor is one of 2 Hz within 0.3 s.

The window is cut into up to 128 parts, and the means of the parts are compared with models of a Gaussian process: white
noise alone, or with it

- power laws of 1/f, 1/f^1.5, 1/f^2 and 1/f^4 that become flat below a corner of less than 6 cycles per window (the
  models that leave the mean open), and processes of first and second order with a corner of 8 cycles or more,
- a band around 1.3 cycles per window and more, such as a tremor, which has no power at zero frequency; with slow parts
  of both kinds,
- a wave that is longer than the window, such as breathing, of which the window shows a trend or a bend; alone or with a
  tremor. Its possible distance from its mean widens the interval.

Mean and standard deviation of each model have flat priors (1 and 1/sigma) and are integrated out. The remaining
likelihoods of Toeplitz covariances are exact, by the recursion of N. Levinson (1947) and J. Durbin (1960). The
posterior of the mean is a mixture of Student's distributions, and the interval contains 95 % of it around the mean of
the window. If models that leave the mean open have more than `MOST_OPEN` of the posterior, there is no interval.

`python -m benchmarks.mean_intervals` measures on synthetic records how often the interval covers the true mean, and how
often there is one. Of 150 windows of each kind (0.3, 1, 3 and 10 s): the share that covers, of those with an interval:

    white                  97 of 97 %    98 of 97 %    95 of 96 %    97 of 98 %
    1/f, 1/f^1.5, 1/f^2    3 to 6 %, 3 to 5 % and at most 1 % have one, and it covers in half of them or less
    hand, 2 Hz             0 of 2 %      0 of 2 %      81 of 48 %    93 of 89 %
    the same, 2nd order    none          none          0 of 1 %      98 of 100 %
    tremor, 9 Hz           100 of 9 %    93 of 100 %   100 of 100 %  100 of 100 %

So a power law nearly always has no interval, and a wrong one in one of forty windows.

With waves longer than the window in the model, of 200 windows of each kind of hand (0.7, 1.5 and 4 s):

    white                  100 of 98 %    97 of 98 %   96 of 99 %
    tremor of 7 to 12 Hz    87 of 64 %    90 of 68 %   98 of 95 %
    the same and 1/f        81 of 35 %    76 of 32 %   72 of 23 %
    hand, 2 to 4 Hz         63 of 10 %    84 of 30 %   95 of 89 %
    pulse, 1.2 Hz          100 of 29 %    none         95 of 100 %
    breathing, 0.25 Hz      84 of 87 %    99 of 100 %  89 of 97 %
    breathing and tremor    85 of 58 %    60 of 68 %   88 of 99 %

A drift slower than all waves of the model is covered less often than stated: of 40 windows with a wave of 0.05 Hz and a
tremor, all had an interval, which covered in 45, 85 and 70 % (0.7, 1.5 and 4 s). If waves of so small a part of a cycle
were to leave the mean open, breathing with tremor would have no interval in half of its windows of 0.7 s, and the drift
would still have one in half.

Without waves in the model, none of the few windows of breathing of 0.7 s that had an interval covered.
"""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis.intervals import DEVIATIONS, student

Series = npt.NDArray[np.float64]
CONFIDENCE = 0.95
# A window is divided into at most this number of parts.
MOST_PARTS = 128
# With fewer parts than this no model can be distinguished from another.
FEWEST_PARTS = 24
# greatest posterior probability of models that leave the mean open with which there is an interval
MOST_OPEN = 0.13
# The weight of the prior of white noise alone.
_WHITE = 10.0
# The weight of the priors with slow parts that leave the mean open.
_OPEN = 1.2
# The weight of the priors with slow parts that do not leave it open.
_SETTLED = 3.0
# The weight of the priors with bands.
_BAND = 0.5
# The weight of the priors with waves that are longer than the window.
_WAVE = 2.0
# The corners of the slow parts [cycles a window].
_OPEN_CORNERS = (0.03, 0.1, 0.3, 1.0, 2.0, 3.5, 5.5)
_SETTLED_CORNERS = (8.0, 11.0, 16.0, 23.0, 32.0, 45.0)
# The exponents of their spectra.
_OPEN_EXPONENTS = (1.0, 1.5, 2.0, 4.0)
_SETTLED_EXPONENTS = (2.0, 4.0)
# The white noise beside them, as a part of their variance.
_WHITE_PARTS = (0.0, 0.1, 0.5, 3.0)
# The middle of the lowest band [cycles a window].
_FIRST_BAND = 1.3
# The middle of a band is this multiple of that of the band below it.
_NEXT_BAND = 1.17
# The number of middles of bands.
_BANDS = 26
# The middles of the waves that are longer than the window [cycles a window], of which it shows a trend or a bend.
_WAVES = (0.06, 0.09, 0.13, 0.18, 0.25, 0.35, 0.5, 0.7, 0.95)
# The middle of such a wave is one of these multiples of its width.
_WAVE_QUALITIES = (15.0, 100.0)
# The white noise beside such a wave, as a part of its variance.
_WAVE_WHITE_PARTS = (0.003, 0.03, 0.3, 3.0)
# The middle of a band is one of these multiples of its width.
_QUALITIES = (4.0, 15.0, 100.0)
# The white noise beside a band, as a part of its variance.
_BAND_WHITE_PARTS = (0.003, 0.1, 1.0)
# A variance is at least this, so that it can be a divisor.
_LEAST_VARIANCE = 1e-12


class Models(NamedTuple):
    """Models of n parts: whether each leaves the mean open, its log prior, and its prediction of a part.

    phi: the weights of the earlier parts, shape (models, n, n); variance: that of the residual, shape (models, n);
    log_volume: half the sum of its logarithms; ones: the residual of a constant 1, shape (models, n).
    """

    is_open: npt.NDArray[np.bool_]
    log_prior: Series
    phi: Series
    variance: Series
    ones: Series
    log_volume: Series


def mean_half_width(values: Series) -> float | None:
    """Return half the interval of 95 % of the mean of correlated samples.

    Args:
        values: The samples in the order of time, equally far apart, shape (n,).

    Returns:
        Half the interval, in the unit of the samples; 0 if they are all equal, and None if they do not show how well
        their mean is known: fewer than 24 samples, or slow parts that continue in a longer record.
    """
    count = min(MOST_PARTS, values.size)
    if count < FEWEST_PARTS:
        return None
    parts = values[: values.size // count * count].reshape(count, -1).mean(axis=1) - values.mean()
    size = float(np.sqrt(np.mean(parts * parts)))
    if size == 0.0:
        return 0.0
    weights, middles, widths, unsettled = _posterior(parts / size)
    return None if unsettled > MOST_OPEN else size * _half_of(weights, middles, widths)


def _posterior(parts: Series) -> tuple[Series, Series, Series, float]:
    """Return weights, means and widths of the posterior's components, and the probability that the mean is open."""
    models, n = _models(parts.size), parts.size
    left = parts - (models.phi * parts).sum(axis=2)
    ones = (models.ones * models.ones / models.variance).sum(axis=1)
    across = (models.ones * left / models.variance).sum(axis=1)
    squares = (left * left / models.variance).sum(axis=1) - across * across / ones
    squares = np.maximum(squares, _LEAST_VARIANCE)
    log = models.log_prior - models.log_volume - 0.5 * np.log(ones) - 0.5 * (n - 1) * np.log(squares)
    weights = np.exp(log - log.max())
    weights /= weights.sum()
    unsettled = float(weights[models.is_open].sum())
    kept = ~models.is_open & (weights > 1e-9)
    # Each Student's distribution is approximated by a normal one with the same interval.
    wider = student(n - 1) / DEVIATIONS
    widths = wider * np.sqrt(squares / ((n - 1) * ones))
    settled = max(float(weights[kept].sum()), 1e-300)
    return weights[kept] / settled, (across / ones)[kept], widths[kept], unsettled


def _half_of(weights: Series, middles: Series, widths: Series) -> float:
    """Return the half width around 0 that contains 95 % of a mixture of normal distributions, by bisection."""
    rows = list(zip(weights.tolist(), middles.tolist(), (math.sqrt(2.0) * widths).tolist(), strict=True))
    low, high = 0.0, max(abs(middle) + 6.0 * width for _, middle, width in rows)
    for _ in range(40):
        half = 0.5 * (low + high)
        inside = math.fsum(
            0.5 * weight * (math.erf((half - middle) / width) + math.erf((half + middle) / width))
            for weight, middle, width in rows
        )
        low, high = (half, high) if inside < CONFIDENCE else (low, half)
    return float(high)


@lru_cache(maxsize=2)
def _models(count: int) -> Models:
    rows = list(_covariances(count))
    is_open = np.array([row[0] for row in rows])
    weights = np.array([row[1] for row in rows])
    covariance = np.array([row[2] / row[2][0] for row in rows])
    covariance[:, 0] += 1e-9
    phi = np.zeros((len(rows), count, count))
    variance = np.empty((len(rows), count))
    variance[:, 0] = covariance[:, 0]
    last = np.zeros((len(rows), count))
    for place in range(1, count):
        ahead = covariance[:, place] - (last[:, : place - 1] * covariance[:, place - 1 : 0 : -1]).sum(axis=1)
        reflection = ahead / variance[:, place - 1]
        longer = last.copy()
        longer[:, : place - 1] -= reflection[:, None] * last[:, : place - 1][:, ::-1]
        longer[:, place - 1] = reflection
        variance[:, place] = np.maximum(variance[:, place - 1] * (1.0 - reflection * reflection), _LEAST_VARIANCE)
        last = longer
        phi[:, place, :place] = last[:, :place][:, ::-1]
    log_volume = 0.5 * np.log(variance).sum(axis=1)
    log_prior = np.log(weights / weights.sum())
    return Models(is_open, log_prior, phi, variance, 1.0 - phi.sum(axis=2), log_volume)


def _covariances(count: int) -> Iterator[tuple[bool, float, Series]]:
    """Yield for each model whether it leaves the mean open, its prior weight, and its covariance by lag in parts."""
    white = np.zeros(count)
    white[0] = 1.0
    yield False, _WHITE, white
    slow = [(e, c, w) for e in _OPEN_EXPONENTS for c in _OPEN_CORNERS for w in _WHITE_PARTS]
    for exponent, corner, part in slow:
        yield True, _OPEN / len(slow), _slow(exponent, corner, count) + part * white
    corners = [corner for corner in _SETTLED_CORNERS if corner < 0.4 * count]
    slow = [(e, c, w) for e in _SETTLED_EXPONENTS for c in corners for w in _WHITE_PARTS]
    for exponent, corner, part in slow:
        # A slow part usually has little white noise beside it, and with much of it it looks like a power law.
        weight = 1.6 if part < 0.3 else 0.4
        yield False, weight * _SETTLED / len(slow), _slow(exponent, corner, count) + part * white
    middles = [_FIRST_BAND * _NEXT_BAND**n for n in range(_BANDS)]
    middles = [middle for middle in middles if middle < 0.5 * count]
    bands = [(m, q, w) for m in middles for q in _QUALITIES for w in _BAND_WHITE_PARTS]
    for middle, quality, part in bands:
        yield False, _BAND / len(bands), _band(middle, quality, count) + part * white
    waves = [(m, q, w) for m in _WAVES for q in _WAVE_QUALITIES for w in _WAVE_WHITE_PARTS]
    for middle, quality, part in waves:
        yield False, _WAVE / len(waves), _band(middle, quality, count) + part * white
    trembling = [(m, b, w) for m in _WAVES[::2] for b in middles[4::2] for w in (0.3, 2.0)]
    for middle, band, part in trembling:
        covariance = _band(middle, 50.0, count) + part * _band(band, 10.0, count) + 0.05 * white
        yield False, _WAVE / len(trembling), covariance
    mixed = [(m, q, e, c) for m in middles[::2] for q in _QUALITIES[:2] for e in (1.0, 2.0) for c in (0.1, 1.0)]
    for middle, quality, exponent, corner in mixed:
        covariance = _band(middle, quality, count) + 0.5 * _slow(exponent, corner, count) + 0.05 * white
        yield True, 0.5 * _BAND / len(mixed), covariance
    mixed = [(m, q, 2.0, c) for m in middles[8::2] for q in _QUALITIES[:2] for c in (8.0, 20.0)]
    for middle, quality, exponent, corner in mixed:
        covariance = _band(middle, quality, count) + 0.7 * _slow(exponent, corner, count) + 0.05 * white
        yield False, 0.5 * _BAND / len(mixed), covariance


def _first_order(corner: float, count: int) -> Series:
    """Return the covariance by lag of part means, for a process of first order with a corner [cycles per window]."""
    rate = 2.0 * math.pi * corner / count
    gone = -math.expm1(-rate)
    weights: Series = (gone / rate) ** 2 * np.exp(-rate * (np.arange(count) - 1.0))
    weights[0] = 2.0 * (rate - gone) / rate**2 if rate > 1e-4 else 1.0
    return weights


def _slow(exponent: float, corner: float, count: int) -> Series:
    """Return the covariance by lag of parts with a spectrum of 1/f^exponent above a corner, with variance 1.

    Between 1 and 2 it is a sum of processes of first order an octave apart; at 4 it is one of second order.
    """
    if exponent == 2.0:
        weights = _first_order(corner, count)
    elif exponent == 4.0:
        rate = 2.0 * math.pi * corner / count * np.arange(count)
        weights = (1.0 + rate) * np.exp(-rate)
    else:
        octaves = range(1 + int(math.log2(20.0 * count / corner)))
        parts = [(corner * 2.0**n) ** (1.0 - exponent) * _first_order(corner * 2.0**n, count) for n in octaves]
        weights = np.sum(parts, axis=0)
    return np.asarray(weights / weights[0])


def _band(middle: float, quality: float, count: int) -> Series:
    """Return the covariance by lag of parts of a second-order band-pass, whose spectrum is 0 at zero frequency."""
    time = np.arange(count) / count
    rate, angular = math.pi * middle / quality, 2.0 * math.pi * middle
    return np.asarray(np.exp(-rate * time) * (np.cos(angular * time) - rate / angular * np.sin(angular * time)))

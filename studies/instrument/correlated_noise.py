"""Linear regression in noise that is partly white and partly wanders: the noise by restricted likelihood, then GLS.

The covariance of two points at the indices i and j is v (1 [i = j] + r exp(-|i - j| / T)): white noise, and one of
Ornstein and Uhlenbeck. The ratio r and the correlation T are weighted by the restricted likelihood (H. D. Patterson, R.
Thompson, Biometrika 58 (1971) 545), which counts what the regression itself takes out of the noise. A drift slower than
the record looks like a wander whose T is as long. A residual alone would be believed to be white, and the errors be too
small by the square root of how many points hang together.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular

Array = npt.NDArray[np.float64]

# Correlation as shares of the record, in points no less than _LEAST_POINTS, and ratio of the variances.
_SHARES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
_LEAST_POINTS = 2.0
_RATIOS = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0)
# by how much a wander has to be likelier to weigh as much as none, as a logarithm: many are tried
_WORTH = 5.0


class Noise(NamedTuple):
    """Coefficients and their covariance; standard deviations of the white noise and the wander, and its T in points.

    zero: for whoever regresses a zero line as well, that line, shape (n,).
    """

    coefficients: Array
    covariance: Array
    white: float
    wander: float
    points: float
    zero: Array = np.zeros(0)


class _Candidate(NamedTuple):
    """Ratio of the variances, correlation in points, and the lower root of the covariance."""

    ratio: float
    points: float
    root: Any


def candidates(index: Array) -> list[_Candidate]:
    """Return the covariances that are tried for points of an index (n,): white noise first."""
    lags = np.abs(index[:, None] - index[None, :])
    lengths = {max(share * float(np.ptp(index)), _LEAST_POINTS) for share in _SHARES}
    one = np.eye(len(index))
    found = [_Candidate(0.0, _LEAST_POINTS, one)]
    for points in sorted(lengths):
        kernel = np.exp(-lags / points)
        found += [_Candidate(ratio, points, np.linalg.cholesky(one + ratio * kernel)) for ratio in _RATIOS]
    return found


def correlated_noise(values: Array, columns: Array, covariances: list[_Candidate]) -> Noise:
    """Regress values, shape (n,), on columns, shape (n, p), in the likeliest noise of `candidates`.

    Raises: numpy.linalg.LinAlgError where the columns do not tell the coefficients apart.
    """
    # columns of one size: their products must not decide which of them are told apart
    size = np.sqrt((columns**2).sum(axis=0))
    if not (np.isfinite(size).all() and size.all()):
        raise np.linalg.LinAlgError("a column is nothing")
    fits = [_generalized(values, columns / size, candidate.root) for candidate in covariances]
    gains = np.array([fit.log_likelihood for fit in fits])
    gains -= [_WORTH if one.ratio else 0.0 for one in covariances]
    # what the noise is like is known no better than the likelihood tells: the mean over all, each with its weight
    weights = np.exp(gains - gains.max())
    weights /= weights.sum()
    mean = sum(weight * fit.coefficients for weight, fit in zip(weights, fits, strict=True))
    covariance = np.zeros((len(size), len(size)))
    for weight, fit in zip(weights, fits, strict=True):
        apart = fit.coefficients - mean
        covariance += weight * (fit.variance * fit.inverse + np.outer(apart, apart))
    best = int(np.argmax(gains))
    ratio, points = covariances[best].ratio, covariances[best].points
    white = math.sqrt(fits[best].variance)
    covariance /= np.outer(size, size)
    return Noise(mean / size, covariance, white, white * math.sqrt(ratio), points if ratio else 0.0)


class _Fit(NamedTuple):
    coefficients: Array
    inverse: Array
    variance: float
    log_likelihood: float


def _generalized(values: Array, columns: Array, root: Array) -> _Fit:
    """Return the fit for a covariance, given by its root but for its size, and its restricted log likelihood."""
    white = solve_triangular(root, np.column_stack([columns, values]), lower=True, check_finite=False)
    x, y = white[:, :-1], white[:, -1]
    normal = x.T @ x
    half = np.linalg.cholesky(normal)
    inverse = np.linalg.inv(normal)
    coefficients = inverse @ (x.T @ y)
    left = y - x @ coefficients
    freedom = len(y) - x.shape[1]
    variance = max(float(left @ left) / freedom, 1e-300)
    logs = float(np.log(np.diag(root)).sum() + np.log(np.diag(half)).sum())
    return _Fit(coefficients, inverse, variance, -0.5 * freedom * math.log(variance) - logs)

"""Linear regression in noise that is partly white and partly wanders: the noise by restricted likelihood, then GLS.

The covariance of two points at the indices i and j is v (1 [i = j] + r exp(-|i - j| / T)): white noise, and one of
Ornstein and Uhlenbeck. The ratio r and the correlation T are weighted by the restricted likelihood (H. D. Patterson, R.
Thompson, Biometrika 58 (1971) 545), which counts what the regression itself takes out of the noise. A drift slower than
the record looks like a wander whose T is as long, and a random walk like one whose T is many records. A residual alone
would be believed to be white, and the errors be too small by the square root of how many points hang together.

One record hardly tells how strong its slowest wander is. So an error is the mean over what the noise may be, and no
less than that of the least favourable noise whose likelihood is within exp(2) of the greatest (the support of A. W. F.
Edwards, Likelihood, 1972, ch. 5).

A wander of this kind remembers its last value only. So each point less what those before it tell of it, over its own
deviation (the innovations of R. E. Kalman, J. Basic Eng. 82 (1960) 35), is white, and takes one pass over the points.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

# Correlation as shares of the record, in points no less than _LEAST_POINTS, and ratio of the variances.
_SHARES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
_LEAST_POINTS = 2.0
_RATIOS = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
# noise is believed possible whose log likelihood is so much less than the greatest
_SUPPORT = 2.0


class Noise(NamedTuple):
    """Coefficients and their covariance; standard deviations of the white noise and the wander, and its T in points.

    zero: for a caller that regresses a zero line as well, that line, shape (n,).
    """

    coefficients: Array
    covariance: Array
    white: float
    wander: float
    points: float
    zero: Array = np.zeros(0)


def correlated_noise(values: Array, columns: Array, index: Array) -> Noise:
    """Regress values, shape (n,), on columns, shape (n, p), in white noise and a wander over an index that rises, (n,).

    Raises: numpy.linalg.LinAlgError where the columns do not tell the coefficients apart.
    """
    # columns of one size: their products must not decide which of them are distinguished
    size = np.sqrt((columns**2).sum(axis=0))
    if not (np.isfinite(size).all() and size.all()):
        raise np.linalg.LinAlgError("a column is nothing")
    lengths = sorted({max(share * float(np.ptp(index)), _LEAST_POINTS) for share in _SHARES})
    ratio, points = (np.ravel(one) for one in np.meshgrid(_RATIOS, lengths))
    ratio, points = np.append(0.0, ratio), np.append(_LEAST_POINTS, points)
    white, logs = _whitened(np.column_stack([columns / size, values]), index, ratio, points)
    x, y = white[:, :, :-1], white[:, :, -1:]
    turned = np.swapaxes(x, 1, 2)
    normal = turned @ x
    halves = np.linalg.cholesky(normal)
    inverse = np.linalg.inv(normal)
    coefficients = inverse @ (turned @ y)
    freedom = len(values) - columns.shape[1]
    variance = np.maximum(((y - x @ coefficients) ** 2).sum(axis=(1, 2)) / freedom, 1e-300)
    gains = -0.5 * freedom * np.log(variance) - logs - np.log(np.diagonal(halves, axis1=1, axis2=2)).sum(axis=1)
    # before the values are looked at, noise that wanders in some way is as likely as noise that does not
    gains[1:] -= math.log(len(gains) - 1)
    # what the noise is like is known no better than the likelihood tells: the mean over all, each with its weight
    weights = np.exp(gains - gains.max())
    weights /= weights.sum()
    mean = np.tensordot(weights, coefficients[:, :, 0], 1)
    apart = coefficients[:, :, 0] - mean
    each = variance[:, None, None] * inverse
    covariance = np.tensordot(weights, each + apart[:, :, None] * apart[:, None, :], 1)
    best = int(np.argmax(gains))
    worst = np.diagonal(each[gains >= gains[best] - _SUPPORT], axis1=1, axis2=2).max(axis=0)
    # Each coefficient has one factor, so that the covariance stays positive definite.
    grown = np.sqrt(np.maximum(worst / np.diagonal(covariance), 1.0)) / size
    deviation = math.sqrt(float(variance[best]))
    return Noise(
        mean / size,
        covariance * np.outer(grown, grown),
        deviation,
        deviation * math.sqrt(float(ratio[best])),
        float(points[best]) if best else 0.0,
    )


def _whitened(values: Array, index: Array, ratio: Array, points: Array) -> tuple[Array, Array]:
    """Return values, shape (n, p), as they are in white noise of the variance 1, for each of m kinds of noise.

    Returns: those, shape (m, n, p), and half the logarithm of the determinant of the covariance, shape (m,).
    """
    count, width = values.shape
    white, logs = np.empty((count, len(ratio), width)), np.zeros(len(ratio))
    expected, uncertain = np.zeros((len(ratio), width)), ratio.copy()
    kept = np.exp(-np.diff(index, prepend=index[0])[:, None] / points)
    for i in range(count):
        expected = expected * kept[i][:, None]
        uncertain = kept[i] ** 2 * uncertain + ratio * (1.0 - kept[i] ** 2)
        total = uncertain + 1.0
        innovation = values[i] - expected
        white[i] = innovation / np.sqrt(total)[:, None]
        logs += 0.5 * np.log(total)
        expected = expected + (uncertain / total)[:, None] * innovation
        uncertain = uncertain / total
    return np.swapaxes(white, 0, 1), logs

"""Linear regression in noise that is partly white and partly correlated: restricted likelihood, then GLS.

The covariance of two points at the indices i and j is v (1 [i = j] + r exp(-|i - j| / T)): white noise plus an
Ornstein-Uhlenbeck process, called the wander. The ratio r and the correlation length T are weighted by the restricted
likelihood (H. D. Patterson, R. Thompson, Biometrika 58 (1971) 545), which allows for the degrees of freedom that the
regression itself uses. A drift slower than the record looks like a wander whose T is as long as the record, a random
walk like one whose T is many records. Assuming white residuals would make the errors too small by the square root of
the number of points that are correlated.

One record hardly determines how strong its slowest wander is. So an error is the mean over all candidate noises, but
no less than that of the least favourable noise whose likelihood is within exp(2) of the greatest (the support of A. W.
F. Edwards, Likelihood, 1972, ch. 5).

A wander of this kind depends on its last value only. So each point less its prediction from the points before it, over
its own deviation (the innovations of R. E. Kalman, J. Basic Eng. 82 (1960) 35), is white, and takes one pass.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.numerics import compiled, compiled_form

Array = npt.NDArray[np.float64]

# Candidates: correlation length as shares of the record, at least _LEAST_POINTS, and ratio of the variances.
_SHARES = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
_LEAST_POINTS = 2.0
RATIOS = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
# A noise counts as possible if its log likelihood is at most this much below the greatest.
_SUPPORT = 2.0


class Noise(NamedTuple):
    """Coefficients, their covariance, deviations of the white noise and of the wander, and the wander's T in points.

    zero: the zero line, shape (n,), for a caller that regresses one as well.
    """

    coefficients: Array
    covariance: Array
    white: float
    wander: float
    points: float
    zero: Array = np.zeros(0)


def correlated_noise(values: Array, columns: Array, index: Array, ratios: Sequence[float] = RATIOS) -> Noise:
    """Regress values on columns in white noise plus a wander along an ascending index.

    Args:
        values: The values, shape (n,).
        columns: The columns, shape (n, p).
        index: The index, shape (n,), ascending.
        ratios: Candidate variances of the wander in units of that of the white noise. Averages over many points need
            greater ones: averaging reduces the white noise and leaves the wander.

    Raises: numpy.linalg.LinAlgError where the columns do not distinguish the coefficients.
    """
    # Columns are scaled to one norm: their scales must not decide which of them are distinguished.
    size = np.array([math.sqrt(math.fsum((column * column).tolist())) for column in columns.T])
    if not (np.isfinite(size).all() and size.all()):
        raise np.linalg.LinAlgError("a column is nothing")
    lengths = sorted({max(share * float(np.ptp(index)), _LEAST_POINTS) for share in _SHARES})
    ratio, points = (np.ravel(one) for one in np.meshgrid(ratios, lengths))
    ratio, points = np.append(0.0, ratio), np.append(_LEAST_POINTS, points)
    white, logs = _whitened(np.column_stack([columns / size, values]), index, ratio, points)
    kinds, width = len(ratio), columns.shape[1]
    coefficients, inverse = np.empty((kinds, width)), np.empty((kinds, width, width))
    squares, halves = np.empty(kinds), np.empty(kinds)
    if not compiled_form(_regress)(white, coefficients, inverse, squares, halves):
        raise np.linalg.LinAlgError("the columns are not distinguished")
    freedom = len(values) - width
    variance = np.maximum(squares / freedom, 1e-300)
    gains = np.array([
        -0.5 * freedom * math.log(v) - log - half
        for v, log, half in zip(variance.tolist(), logs.tolist(), halves.tolist(), strict=True)
    ])  # fmt: skip
    # A priori, noise with any wander is as likely as white noise alone.
    gains[1:] -= math.log(len(gains) - 1)
    # The noise is known no better than its likelihood: average over all candidates, weighted by it.
    best = int(np.argmax(gains))
    shares = [math.exp(gain) for gain in (gains - gains[best]).tolist()]
    whole = math.fsum(shares)
    mean, covariance = np.zeros(width), np.zeros((width, width))
    each = variance[:, None, None] * inverse
    for share, found in zip(shares, coefficients, strict=True):
        mean += share / whole * found
    for share, found, spread in zip(shares, coefficients - mean, each, strict=True):
        covariance += share / whole * (spread + found[:, None] * found[None, :])
    worst = np.diagonal(each[gains >= gains[best] - _SUPPORT], axis1=1, axis2=2).max(axis=0)
    # The factors scale rows and columns alike, so the covariance stays positive definite.
    grown = np.sqrt(np.maximum(worst / np.diagonal(covariance), 1.0)) / size
    deviation = math.sqrt(float(variance[best]))
    return Noise(
        mean / size,
        covariance * (grown[:, None] * grown[None, :]),
        deviation,
        deviation * math.sqrt(float(ratio[best])),
        float(points[best]) if best else 0.0,
    )


def _whitened(values: Array, index: Array, ratio: Array, points: Array) -> tuple[Array, Array]:
    """Return values, shape (n, p), whitened to the variance 1 for each of m candidate noises.

    Returns: the whitened values, shape (m, n, p), and half the logarithm of the determinant of the covariance, shape
    (m,).
    """
    count, width = values.shape
    white, logs = np.empty((len(ratio), count, width)), np.zeros(len(ratio))
    steps = np.diff(index, prepend=index[0])
    compiled_form(_whiten)(np.ascontiguousarray(values), steps, ratio, points, white, logs)
    return white, logs


@compiled
def _whiten(values: Array, steps: Array, ratio: Array, points: Array, white: Array, logs: Array) -> None:
    """Fill white, shape (m, n, p), and logs, shape (m,); the order of the points is fixed, so all processors agree."""
    count, width = values.shape
    expected = np.zeros(width)
    for kind in range(ratio.shape[0]):
        uncertain, total_log, product = ratio[kind], 0.0, 1.0
        before, kept = -1.0, 0.0
        for column in range(width):
            expected[column] = 0.0
        for i in range(count):
            # Most points have the same distance as the two before, so the exponential is reused.
            if steps[i] != before:
                before = steps[i]
                kept = math.exp(-before / points[kind])
            uncertain = kept * kept * uncertain + ratio[kind] * (1.0 - kept * kept)
            total = uncertain + 1.0
            root, gain = 1.0 / math.sqrt(total), uncertain / total
            for column in range(width):
                ahead = kept * expected[column]
                innovation = values[i, column] - ahead
                white[kind, i, column] = innovation * root
                expected[column] = ahead + gain * innovation
            # The product needs one logarithm for many points.
            product *= total
            if product > 1e200:
                total_log += math.log(product)
                product = 1.0
            uncertain = gain
        logs[kind] = 0.5 * (total_log + math.log(product))


@compiled
def _regress(white: Array, coefficients: Array, inverse: Array, squares: Array, halves: Array) -> bool:
    """Regress the last column of white, shape (m, n, p + 1), on the others; return False if they are not distinguished.

    Fill the coefficients, shape (m, p), the inverse of the normal matrix, shape (m, p, p), the sum of the squared
    residuals, shape (m,), and half the logarithm of the determinant of the normal matrix, shape (m,).
    """
    kinds, count, width = white.shape
    free = width - 1
    lower = np.zeros((width, width))
    solved = np.zeros((free, free))
    for kind in range(kinds):
        for row in range(width):
            for column in range(row + 1):
                lower[row, column] = 0.0
        for i in range(count):
            for row in range(width):
                for column in range(row + 1):
                    lower[row, column] += white[kind, i, row] * white[kind, i, column]
        # Cholesky factor of the normal matrix with the values as its last row; its last square is the residual sum.
        half = 0.0
        for row in range(width):
            whole = lower[row, row]
            for column in range(row + 1):
                rest = lower[row, column]
                for i in range(column):
                    rest -= lower[row, i] * lower[column, i]
                if column < row:
                    lower[row, column] = rest / lower[column, column]
                elif row < free:
                    if not rest > 1e-15 * whole:
                        return False
                    lower[row, row] = math.sqrt(rest)
                    half += math.log(lower[row, row])
                else:
                    squares[kind] = max(rest, 0.0)
        halves[kind] = half
        for row in range(free - 1, -1, -1):
            rest = lower[free, row]
            for i in range(row + 1, free):
                rest -= lower[i, row] * coefficients[kind, i]
            coefficients[kind, row] = rest / lower[row, row]
        for column in range(free):
            for row in range(free):
                rest = 1.0 if row == column else 0.0
                for i in range(row):
                    rest -= lower[row, i] * solved[i, column]
                solved[row, column] = rest / lower[row, row]
        for row in range(free):
            for column in range(free):
                total = 0.0
                for i in range(free):
                    total += solved[i, row] * solved[i, column]
                inverse[kind, row, column] = total
    return True

"""The repeated-measures F in closed form: each effect is tested against its variation between people.

The values of a participant are one number per condition, the mean of the trials there. An effect within participants is
a set of orthonormal contrasts of these numbers, so each participant has a score for it, and the error of the test is
the scatter of the scores between participants: effect x participant. The covariance of the scores gives the correction
for sphericity; a single contrast needs none. Factors between participants are contrasts of the means of groups, and the
error is then the scatter within the groups. (B. J. Winer, D. R. Brown and K. M. Michels, Statistical Principles in
Experimental Design, 3rd ed. (1991), chapters 4 and 7.)

Except for the tails of the F distribution, all results are sums and products in a fixed order, which have the same bits
on every processor. Leading axes are experiments of the same design, which are computed at once.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano_lab.experiments.psychophysics.exact import total

Matrix = npt.NDArray[np.float64]


class RepeatedF(NamedTuple):
    """The F tests of one effect; each array has an element per experiment.

    Args:
        f: The F ratio; nan or infinite if people do not differ in the effect at all.
        df1: Degrees of freedom of the effect, uncorrected.
        df2: Degrees of freedom of the error, uncorrected.
        epsilon: The correction of Huynh and Feldt for sphericity, a factor of both.
        estimate: The estimated contrasts, of shape (…, contrasts of groups, contrasts of conditions).
        variance: The variance of each of them, of the same shape.
    """

    f: Matrix
    df1: float
    df2: float
    epsilon: Matrix
    estimate: Matrix
    variance: Matrix

    @property
    def p(self) -> Matrix:
        """The p values with the corrected degrees of freedom."""
        from scipy import stats

        return np.asarray(stats.f.sf(self.f, self.epsilon * self.df1, self.epsilon * self.df2))


def contrasts(levels: Sequence[float] | int) -> Matrix:
    """Return orthonormal contrasts of the levels of a factor, a row each.

    Args:
        levels: The number of levels, for all contrasts (those of Helmert); or numbers, for a single contrast, the slope
            over them.
    """
    if not isinstance(levels, int):
        numbers = np.asarray(levels, dtype=float)
        centred = numbers - total(numbers) / len(numbers)
        return np.asarray(centred / np.sqrt(total(centred * centred)))[None, :]
    result = np.zeros((levels - 1, levels))
    for row in range(1, levels):
        result[row - 1, :row], result[row - 1, row] = 1.0, -float(row)
        result[row - 1] /= np.sqrt(float(row * (row + 1)))
    return result


def average(levels: int) -> Matrix:
    """Return the normalised mean over levels: the row of a factor that is not part of an effect."""
    return np.full((1, levels), 1.0 / np.sqrt(float(levels)))


def product(parts: Sequence[Matrix]) -> Matrix:
    """Return the products of every row of each part with every row of the next; the last part varies fastest."""
    result = np.ones((1, 1))
    for part in parts:
        whole = result[:, None, :, None] * part[None, :, None, :]
        result = whole.reshape(len(result) * len(part), -1)
    return result


def repeated_f(cells: Matrix, within: Matrix, groups: Sequence[int] = (), between: Matrix | None = None) -> RepeatedF:
    """Test an effect.

    Args:
        cells: The values, of shape (…, participants, conditions).
        within: The contrasts of the effect, of shape (contrasts, conditions): orthonormal rows.
        groups: The group of each participant, from 0, with two or more in each; empty for a single group.
        between: The contrasts of the groups' means, of shape (contrasts, groups); None for their mean.
    """
    scores = total(cells[..., None, :] * within)
    label = np.asarray(groups or [0] * cells.shape[-2])
    sizes = np.bincount(label)
    error_df = len(label) - len(sizes)
    means = np.stack([_mean(scores[..., label == group, :]) for group in range(len(sizes))], axis=-2)
    rest = np.moveaxis(scores - means[..., label, :], -2, -1)
    covariance = total(rest[..., :, None, :] * rest[..., None, :, :]) / error_df
    number = len(within)
    trace = total(np.diagonal(covariance, axis1=-2, axis2=-1))
    rows = average(len(sizes)) if between is None else between
    estimate = total(np.moveaxis(means, -2, -1)[..., None, :, :] * rows[:, None, :])
    weights = total(rows[:, None, :] * rows[None, :, :] / sizes)
    effect = sum(total(row * row) for row in _whitened(estimate, weights))
    df1 = float(len(rows) * number)
    with np.errstate(divide="ignore", invalid="ignore"):
        f = (effect / df1) / (trace / number)
        squares = total(total(covariance * covariance))
        greenhouse = np.where(squares > 0.0, trace * trace / (number * squares), 1.0)
    variance = np.diagonal(weights)[:, None] * np.diagonal(covariance, axis1=-2, axis2=-1)[..., None, :]
    return RepeatedF(f, df1, float(number * error_df), _epsilon(greenhouse, number, error_df), estimate, variance)


def _epsilon(greenhouse: Matrix, contrasts: int, error_df: int) -> Matrix:
    """Return the ε of H. Huynh and L. S. Feldt (J. Educ. Stat. 1 (1976) 69) from that of Greenhouse and Geisser.

    It includes the correction of B. Lecoutre (J. Educ. Stat. 16 (1991) 371) for groups. The ε of Greenhouse and Geisser
    alone is too conservative: with twelve conditions and six people it rejects in 1 to 3 % instead of 5 %.
    """
    if contrasts == 1:
        return np.ones_like(greenhouse)
    scaled = contrasts * greenhouse
    rest = contrasts * (error_df - scaled)
    feldt = np.where(rest > 0.0, ((error_df + 1) * scaled - 2.0) / np.where(rest > 0.0, rest, 1.0), 1.0)
    return np.asarray(np.clip(feldt, greenhouse, 1.0))


def _mean(values: Matrix) -> Matrix:
    """Return the mean over the last axis but one."""
    return np.asarray(total(np.moveaxis(values, -2, -1)) / values.shape[-2])


def _whitened(estimate: Matrix, weights: Matrix) -> list[Matrix]:
    """Divide the rows of estimates by the Cholesky factor of their covariance, so that they are independent."""
    size = len(weights)
    factor = np.zeros((size, size))
    rows: list[Matrix] = []
    for i in range(size):
        row = estimate[..., i, :]
        for j in range(i):
            factor[i, j] = (weights[i, j] - sum(factor[i, k] * factor[j, k] for k in range(j))) / factor[j, j]
            row = row - factor[i, j] * rows[j]
        factor[i, i] = np.sqrt(weights[i, i] - sum(factor[i, k] * factor[i, k] for k in range(i)))
        rows.append(row / factor[i, i])
    return rows

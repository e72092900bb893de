"""Linear least squares without LAPACK, whose kernels, and with them the last digit, depend on the processor."""

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]
# A column counts as dependent on those before it if its remainder is below this share of its norm.
_OWN_SHARE = 1e-9


def regression(columns: Sequence[Series], values: Series) -> tuple[list[float], Series]:
    """Fit values by a linear combination of columns.

    Args:
        columns: The columns, each of shape (n,).
        values: The values to fit, shape (n,).

    Returns:
        The factor of each column, 0 for a column that depends on those before it, and the residuals, shape (n,).
    """
    # Gram-Schmidt orthogonalisation, twice, to remove the rounding errors of the first pass.
    kept: list[tuple[int, Series]] = []
    upper = np.zeros((len(columns), len(columns)))
    for number, column in enumerate(columns):
        own = np.asarray(column, dtype=np.float64)
        for _ in range(2):
            for before, unit in kept:
                factor = float((unit * own).sum())
                upper[before, number] += factor
                own = own - factor * unit
        size = math.sqrt(float((own * own).sum()))
        if size > _OWN_SHARE * math.sqrt(float((column * column).sum())):
            upper[number, number] = size
            kept.append((number, own / size))
    left, parts = np.asarray(values, dtype=np.float64), [0.0] * len(columns)
    for number, unit in kept:
        parts[number] = float((unit * left).sum())
        left = left - parts[number] * unit
    factors = [0.0] * len(columns)
    for number, _ in reversed(kept):
        further = sum(upper[number, after] * factors[after] for after in range(number + 1, len(columns)))
        factors[number] = float((parts[number] - further) / upper[number, number])
    return factors, left

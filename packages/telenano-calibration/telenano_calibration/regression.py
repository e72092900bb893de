"""A straight line through points, with its error."""

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def regressed(x: Array, y: Array) -> tuple[float, float, float]:
    """Return slope, its standard error and the scatter about the line, of three or more points.

    Where all points have the same x the slope is 0, and what is known of it nothing.
    """
    x = x - x.mean()
    square = float((x * x).sum())
    if not square > 0.0:
        return 0.0, math.inf, math.inf
    slope = float((x * y).sum()) / square
    residual = y - y.mean() - slope * x
    scatter = math.sqrt(float((residual**2).sum()) / (len(x) - 2))
    return slope, scatter / math.sqrt(square), scatter

"""Straight lines through measured points, for calibrations: scale, zero, standard error of the scale."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from telenano.analysis import denied
from telenano.wire import TelenanoError

Array = npt.NDArray[np.float64]

# The largest distance of a point from the line, as a share of the span of all points.
MOST_RESIDUAL = 0.02


class CalibrationError(TelenanoError):
    """No calibration follows from the measured points; the text names the point at fault."""


class LineFit(NamedTuple):
    """value = (count - zero) * scale, with the standard error of the scale."""

    scale: float
    zero: float
    scale_error: float


def fit_line(what: str, counts: Sequence[float], errors: Sequence[float], values: Sequence[float]) -> LineFit:
    """Return the straight line through measured points, by least squares.

    The standard error of the scale is that of the counts or of the scatter about the line, whichever is greater.

    Args:
        what: The measured quantity in words, for the messages.
        counts: The counts, two or more.
        errors: The standard errors of the counts.
        values: The values that the counts stand for.

    Raises:
        CalibrationError: There are fewer than two different values, the counts differ only within their noise, or a
            point is further off the line than 2 % of the span.
    """
    number = len(counts)
    mean_value, mean_count = sum(values) / number, sum(counts) / number
    spread = sum((value - mean_value) ** 2 for value in values)
    if number < 2 or spread == 0.0:
        raise CalibrationError(f"{what}: two different values are needed, found {', '.join(f'{v:g}' for v in values)}")
    pairs = list(zip(values, counts, strict=True))
    slope = sum((value - mean_value) * (count - mean_count) for value, count in pairs) / spread
    span = abs(slope) * (max(values) - min(values))
    if reason := denied("the span of the counts", span, max(errors)):
        raise CalibrationError(f"{what}: {reason}: move further between the points")
    residuals = [count - mean_count - slope * (value - mean_value) for value, count in pairs]
    worst, value = max(zip(map(abs, residuals), values, strict=True))
    if worst > MOST_RESIDUAL * span:
        raise CalibrationError(
            f"{what}: the point at {value:g} is {worst / span:.1%} of the span off the line, {MOST_RESIDUAL:.0%} are "
            "allowed: measure it again"
        )
    scatter = math.sqrt(sum(residual**2 for residual in residuals) / (number - 2) / spread) if number > 2 else 0.0
    noise = max(errors) / math.sqrt(spread)
    scale = 1.0 / slope
    if reason := denied("the scale", abs(scale), max(scatter, noise) * scale**2):
        raise CalibrationError(f"{what}: {reason}: take more points, further apart")
    return LineFit(scale, mean_count - slope * mean_value, max(scatter, noise) * scale**2)


def mean_of(estimates: Sequence[float]) -> tuple[float, float]:
    """Return the mean of two or more values, and the standard error of the mean."""
    mean = math.fsum(estimates) / len(estimates)
    variance = math.fsum((value - mean) ** 2 for value in estimates) / (len(estimates) - 1)
    return mean, math.sqrt(variance / len(estimates))


def regressed(x: Array, y: Array) -> tuple[float, float, float]:
    """Return the slope of a line through three or more points, its standard error, and the scatter about the line.

    If all points have the same x, the slope is 0, and both errors are infinite.
    """
    x = x - x.mean()
    square = float((x * x).sum())
    if not square > 0.0:
        return 0.0, math.inf, math.inf
    slope = float((x * y).sum()) / square
    residual = y - y.mean() - slope * x
    scatter = math.sqrt(float((residual**2).sum()) / (len(x) - 2))
    return slope, scatter / math.sqrt(square), scatter

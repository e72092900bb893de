"""Noise and rounding step of a read-out, and the range of a force without them."""

import math

import numpy as np
import numpy.typing as npt

from telenano.analysis.modes import LEAST_SAMPLES, centred, noise_floor

Series = npt.NDArray[np.float64]
# number of parts in whose means a one-sided motion is searched [1]
_WAY_PARTS = 8


def rounding_of(values: Series) -> float:
    """Return the step of a read-out that rounds [N]; 0 if it does not."""
    steps = np.abs(np.diff(values))
    moved = steps[steps > 0.0]
    return float(moved.min()) if len(moved) and len(np.unique(values)) < len(values) / 4 else 0.0


def noise_of(values: Series, step_n: float) -> float:
    """Return the standard deviation of the noise of a read-out [N], at least that of rounding to a step [N]."""
    return max(noise_floor(values) if len(values) >= LEAST_SAMPLES else 0.0, step_n / math.sqrt(12.0))


def reach_of(noise_n: float, count: int) -> float:
    """Return the greatest excursion to one side [N] of `count` samples of white noise, by its deviation [N]."""
    return noise_n * (math.sqrt(2.0 * math.log(max(count, 2))) + 1.0)


def moved_of(values: Series, noise_n: float) -> float:
    """Return the range of a force [N], less that which as many samples of white noise exceed once in a thousand."""
    return max(float(np.ptp(values)) - 2.0 * reach_of(noise_n, len(values)), 0.0)


def gone_of(values: Series) -> float:
    """Return the distance [N] between the means of the first and last eighth, if the later half has most; else 0."""
    part = max(1, len(values) // _WAY_PARTS)
    middle = (len(values) - part) // 2
    first, then, last = (float(np.cumsum(values[k : k + part])[-1]) / part for k in (0, middle, len(values) - part))
    return abs(last - first) if (last - then) * (last - first) > 0.5 * (last - first) ** 2 else 0.0


def goes_over_steps(values: Series, step_n: float, small_n: float) -> bool:
    """Return whether the range of a rounded force surely exceeds small_n [N]; False for a read-out that does not round.

    Rounding shifts each end by half a step [N] at most.
    """
    return step_n > 0.0 and float(np.ptp(level(values))) - step_n > small_n


def level(values: Series) -> Series:
    """Return a series without its least-squares straight line."""
    at = np.arange(len(values)) - 0.5 * (len(values) - 1)
    bare = centred(values)
    return bare - float(np.cumsum(at * bare)[-1]) / max(float(np.cumsum(at * at)[-1]), 1.0) * at


def line_n(left: Series, turns: float) -> float:
    """Return the peak-to-peak size [N] of the sine with this number of turns in a series."""
    angle = 2.0 * math.pi * turns * np.arange(len(left)) / max(1, len(left) - 1)
    bare = centred(left)
    cosine, sine = (float(np.cumsum(bare * wave)[-1]) for wave in (np.cos(angle), np.sin(angle)))
    return 4.0 * math.hypot(cosine, sine) / len(left)


def even(time_s: Series, force_n: Series) -> tuple[Series, float]:
    """Return the force on an even grid of as many samples, and its period [s], because messages are unevenly spaced."""
    grid = np.linspace(time_s[0], time_s[-1], len(time_s))
    period_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if float(np.abs(time_s - grid).max()) <= 1e-6 * period_s:
        return np.asarray(force_n, dtype=np.float64), period_s
    return np.interp(grid, time_s, force_n), period_s

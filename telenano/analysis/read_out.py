"""What noise and the steps of a read-out are, and how far a force goes without them."""

import math

import numpy as np
import numpy.typing as npt

from telenano.analysis.modes import LEAST_SAMPLES, centred, noise_floor
from telenano.analysis.verdict_thresholds import LEAST_TURNS

Series = npt.NDArray[np.float64]
# eighths in which a way is looked for [1]
_WAY_PARTS = 8


def rounding_of(values: Series) -> float:
    """Return the step of a read-out that rounds [N]; 0 of one that does not.

    Two values that do not alternate show no step: a tip that lands and rests changes its force once.
    """
    steps, count = np.abs(np.diff(values)), len(np.unique(values))
    moved = steps[steps > 0.0]
    is_landing = count <= 2 and len(moved) < 2.0 * LEAST_TURNS
    return float(moved.min()) if not is_landing and count < len(values) / 4 else 0.0


def noise_of(values: Series, step_n: float) -> float:
    """Return the standard deviation of the noise of a read-out [N], of which a step that it rounds to is a part."""
    return max(noise_floor(values) if len(values) >= LEAST_SAMPLES else 0.0, step_n / math.sqrt(12.0))


def reach_of(noise_n: float, count: int) -> float:
    """Return what white noise of a standard deviation [N] reaches to one side in a number of samples [N]."""
    return noise_n * (math.sqrt(2.0 * math.log(max(count, 2))) + 1.0)


def moved_of(values: Series, noise_n: float) -> float:
    """Return how far a force goes [N], less what white noise of as many samples reaches once in a thousand times."""
    return max(float(np.ptp(values)) - 2.0 * reach_of(noise_n, len(values)), 0.0)


def gone_of(values: Series) -> float:
    """Return how far the force goes [N] from eighth to eighth, if it goes farther in the later half; otherwise 0."""
    part = max(1, len(values) // _WAY_PARTS)
    middle = (len(values) - part) // 2
    first, then, last = (float(np.cumsum(values[k : k + part])[-1]) / part for k in (0, middle, len(values) - part))
    return abs(last - first) if (last - then) * (last - first) > 0.5 * (last - first) ** 2 else 0.0


def line_n(left: Series, turns: float) -> float:
    """Return from peak to peak what a series has at a line that turns so often in it [N]."""
    angle = 2.0 * math.pi * turns * np.arange(len(left)) / max(1, len(left) - 1)
    bare = centred(left)
    cosine, sine = (float(np.cumsum(bare * wave)[-1]) for wave in (np.cos(angle), np.sin(angle)))
    return 4.0 * math.hypot(cosine, sine) / len(left)


def even(time_s: Series, force_n: Series) -> tuple[Series, float]:
    """Return the force on an even grid of as many samples, and its period [s]; messages come when they come."""
    grid = np.linspace(time_s[0], time_s[-1], len(time_s))
    period_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if float(np.abs(time_s - grid).max()) <= 1e-6 * period_s:
        return np.asarray(force_n, dtype=np.float64), period_s
    return np.interp(grid, time_s, force_n), period_s

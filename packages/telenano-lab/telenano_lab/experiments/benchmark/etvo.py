"""Effective time-offset and value-offset of a received signal against the sent one.

The idea is that of H. J. C. Kroep, V. Gokhale, J. Verburg, R. Venkatesha Prasad, "ETVO: Effectively Measuring Tactile
Internet with Experimental Validation", arXiv:2107.05343: the received signal is warped onto the sent one; the warp is
an offset in time, the remaining difference an offset in value. They refine dynamic time warping with weights of their
own; the definition here is the following, and its figures do not equal theirs to the digit.

Both signals are given on a grid of dt, relative to their means over the received window: a constant offset is a
separate measure. For each received sample y_n a lag l_n of 0 to L steps is sought with

    sum over n of |y_n - x_(n - l_n)| / s + w |l_n - l_(n-1)|   least,   l_n <= l_(n-1) + 1,

s the peak-to-peak value of x and w = LAG_WEIGHT: changing the lag by one step costs as much as a value that is wrong by
that share of s for one sample, and the received signal never goes back in the sent one. The effective time-offset is
the mean of l_n dt, the effective value-offset the RMS of y_n - x_(n - l_n). The least sum is found exactly, by dynamic
programming, and sums are rounded once (`math.fsum`), so that no library's order of summation matters.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

# With a lower weight, a signal of another size would pass for a late one; with a higher one, a changing delay would
# pass for an error of value.
LAG_WEIGHT = 0.5


class Offsets(NamedTuple):
    """time_s: effective time-offset [s]; value: effective value-offset, in the unit of the signals."""

    time_s: float
    value: float


def etvo(sent: Series, received: Series, dt: float, lags: int) -> Offsets | None:
    """Return the offsets of a received signal; None if the sent one is constant.

    Args:
        sent: x, shape (lags + n,); it begins `lags` samples before the received one.
        received: y, shape (n,), n >= 2.
        dt: The sampling period [s].
        lags: The longest lag, L.
    """
    swing, count = float(sent.max() - sent.min()), len(received)
    if swing == 0.0:
        return None
    sent, received = sent - math.fsum(sent[lags:].tolist()) / count, received - math.fsum(received.tolist()) / count
    # Row n has the sent values at n for the lags 0 to L.
    past = np.lib.stride_tricks.sliding_window_view(sent, lags + 1)[:count, ::-1]
    local = np.abs(received[:, None] - past) / swing
    best, totals = np.empty_like(local), local[0].copy()
    best[0] = totals
    ramp = LAG_WEIGHT * np.arange(lags + 1, dtype=np.float64)
    for n in range(1, count):
        totals = _reached(totals, ramp) + local[n]
        best[n] = totals
    path = _traced(best, ramp)
    errors = [float(received[n] - past[n, lag]) for n, lag in enumerate(path)]
    return Offsets(dt * sum(path) / count, math.sqrt(math.fsum(e * e for e in errors) / count))


def _reached(totals: Series, ramp: Series) -> Series:
    """Return the least sum with which each lag is reached: from a greater one, or from the one below it."""
    falling = np.minimum.accumulate((totals + ramp)[::-1])[::-1] - ramp
    falling[1:] = np.minimum(falling[1:], totals[:-1] + LAG_WEIGHT)
    return falling


def _traced(best: Series, ramp: Series) -> list[int]:
    """Return the lags of the least sum, traced from the last sample back to the first."""
    lag = int(best[-1].argmin())
    path = [lag]
    for totals in best[-2::-1]:
        first = max(lag - 1, 0)
        lag = first + int((totals[first:] + np.abs(ramp[first:] - ramp[lag])).argmin())
        path.append(lag)
    return path[::-1]

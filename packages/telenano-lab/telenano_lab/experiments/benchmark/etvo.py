"""Effective time-offset and value-offset of what is received against what was sent.

The idea is that of H. J. C. Kroep, V. Gokhale, J. Verburg, R. Venkatesha Prasad, "ETVO: Effectively Measuring Tactile
Internet with Experimental Validation", arXiv:2107.05343: the received signal is warped onto the sent one, and what the
warp explains is an offset in time, what it leaves is an offset in value. They refine dynamic time warping with weights
of their own; the definition here is the following, and its figures are not theirs digit by digit.

Both signals are given on a grid of dt, and taken about their means over the received window: a lasting offset is a
measure of its own. For each received sample y_n a lag l_n of 0 to L steps is sought with

    sum over n of |y_n - x_(n - l_n)| / s + w |l_n - l_(n-1)|   least,   l_n <= l_(n-1) + 1,

s the peak-to-peak value of x and w = LAG_WEIGHT: to change the lag by one step costs as much as a value that is wrong
by that share of s for one sample, and what was received never goes back in what was sent. The effective time-offset is
the mean of l_n dt, the effective value-offset the RMS of y_n - x_(n - l_n). The least sum is found exactly, by dynamic
programming, and sums are rounded once (`math.fsum`), so that no library's order of summation has a part in it.
"""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]

# With less, a signal of another size passes for one that is late; with more, a delay that changes passes for a value.
LAG_WEIGHT = 0.5


class Offsets(NamedTuple):
    """time_s: effective time-offset [s]; value: effective value-offset, in the unit of the signals."""

    time_s: float
    value: float


def etvo(sent: Series, received: Series, dt: float, lags: int) -> Offsets | None:
    """Return the offsets of a received signal, None where nothing was sent that moves.

    Args:
        sent: x, shape (lags + n,): it begins `lags` samples before the received one.
        received: y, shape (n,), n >= 2.
        dt: The distance of two samples [s].
        lags: The longest lag, L.
    """
    swing, count = float(sent.max() - sent.min()), len(received)
    if swing == 0.0:
        return None
    sent, received = sent - math.fsum(sent[lags:].tolist()) / count, received - math.fsum(received.tolist()) / count
    # Row n has what the lags 0 to L would have given at n.
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
    """Return the lags of the least sum, from the last sample back to the first."""
    lag = int(best[-1].argmin())
    path = [lag]
    for totals in best[-2::-1]:
        first = max(lag - 1, 0)
        lag = first + int((totals[first:] + np.abs(ramp[first:] - ramp[lag])).argmin())
        path.append(lag)
    return path[::-1]

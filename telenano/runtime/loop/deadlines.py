"""Absolute periodic deadlines, and statistics of the lateness with which they were met."""

import numpy as np
import numpy.typing as npt

_WINDOW = 8192


class LatenessWindow:
    """Lateness of the last 8192 steps at most [s], for the quantiles of a report; recording is one array store."""

    def __init__(self) -> None:
        self._samples: npt.NDArray[np.float64] = np.zeros(_WINDOW)
        self._count = 0

    def record(self, lateness_s: float) -> None:
        self._samples[self._count % _WINDOW] = lateness_s
        self._count += 1

    def take(self) -> tuple[float, float, float]:
        """Return p50, p99 and maximum of the lateness [s] since the last call, and reset; zeros without samples."""
        used = np.sort(self._samples[: min(self._count, _WINDOW)])
        self._count = 0
        if used.size == 0:
            return 0.0, 0.0, 0.0
        return _quantile(used, 0.5), _quantile(used, 0.99), float(used[-1])


def _quantile(ordered: npt.NDArray[np.float64], share: float) -> float:
    # np.percentile would take a quarter of a millisecond, in which a command may arrive.
    place = share * (ordered.size - 1)
    i = int(place)
    low, high = float(ordered[i]), float(ordered[min(i + 1, ordered.size - 1)])
    return low + (place - i) * (high - low)


def deadline_after(deadline_ns: int, now_ns: int, period_ns: int) -> int:
    """Return the next deadline of a grid after one that is due, skipping those missed by a period or more [ns]."""
    return deadline_ns + (max(0, now_ns - deadline_ns) // period_ns + 1) * period_ns


class PeriodicDeadline:
    """A grid of absolute deadlines: a late step does not move later ones; missed deadlines are skipped and counted."""

    def __init__(self, start_ns: int, period_ns: int) -> None:
        if period_ns <= 0:
            raise ValueError(f"period_ns is {period_ns}, must be 1 or more")
        self.period_ns = period_ns
        self.deadline_ns = start_ns + period_ns
        self.overruns = 0

    def advance(self, now_ns: int) -> int:
        """Advance past the deadline that is due, and past those missed by a period or more.

        Returns:
            The number of periods since the last step, 1 unless deadlines were missed.
        """
        before_ns, self.deadline_ns = self.deadline_ns, deadline_after(self.deadline_ns, now_ns, self.period_ns)
        periods = (self.deadline_ns - before_ns) // self.period_ns
        self.overruns += periods - 1
        return periods

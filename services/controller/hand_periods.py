"""The periods of the hand between its samples, counted by the time stamps that they carry."""


class HandPeriods:
    """Counts on the hand's grid, which is absolute: however late single samples are, no period is counted twice.

    Where the grid is follows from the stamps: a sample moves it by a small share of what it is off, because even the
    first one may have been late. To round each difference of two stamps by itself would count 2, 1, 1 periods for the
    three from 0 by 1.6 and 2.4 to 3.0 ms.
    """

    _SHARE = 64

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._grid_ns = 0

    def begin(self, t_ns: int) -> None:
        """Start anew at a sample [ns]."""
        self._grid_ns = t_ns

    def counted(self, t_ns: int) -> int:
        """Return the periods since the last sample, 0 if that one was so late that they were counted with it."""
        since_ns = t_ns - self._grid_ns
        periods = max(0, (since_ns + self._period_ns // 2) // self._period_ns)
        off_ns = since_ns - periods * self._period_ns
        self._grid_ns += periods * self._period_ns + off_ns // self._SHARE
        return periods

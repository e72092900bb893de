"""Time of a device's samples on the clock of this process, from the device's own microseconds."""

_WRAP_US = 2**32
# a block is long enough to hold a frame that met no delay, and short enough for a resonator that is off by 0.5 %
_BLOCK_NS = 100_000_000


class RecentMinimum:
    """The least of the last two blocks of 0.1 s."""

    def __init__(self) -> None:
        self._began_ns = 0
        self._now: int | None = None
        self._before: int | None = None

    def least(self, value: int, at_ns: int) -> int:
        """Take a value of the time at_ns [ns], and return the least of the recent ones."""
        if self._now is None or at_ns - self._began_ns > _BLOCK_NS:
            self._before, self._now, self._began_ns = self._now, value, at_ns
        self._now = min(self._now, value)
        return self._now if self._before is None else min(self._now, self._before)


class SampleClock:
    """Ties a device's clock to that of the host by the frames that took least time, as the link does with sites."""

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._unwrapped_us = 0
        self._ahead = RecentMinimum()

    def host_ns(self, device_us: int, received_ns: int) -> int:
        """Return when a sample was taken [ns], plus the shortest way to the host; never after its reception.

        Args:
            device_us: The time of the device [us], modulo 2^32, as the device sends it.
            received_ns: When the sample was received, on the clock of this process [ns].
        """
        step_us = 0 if self._last_us is None else (device_us - self._last_us) % _WRAP_US
        self._last_us = device_us
        self._unwrapped_us += step_us
        device_ns = self._unwrapped_us * 1000
        return device_ns + self._ahead.least(received_ns - device_ns, received_ns)

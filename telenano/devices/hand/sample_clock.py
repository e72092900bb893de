"""Converts the time of a device's samples, in its own microseconds, to the clock of this process."""

_WRAP_US = 2**32
# A block is long enough to hold a frame without delay, and short enough for a resonator that is off by 0.5 %.
_BLOCK_NS = 100_000_000


class RecentMinimum:
    """The minimum over the last two blocks of 0.1 s."""

    def __init__(self) -> None:
        self._began_ns = 0
        self._now: int | None = None
        self._before: int | None = None

    def least(self, value: int, at_ns: int) -> int:
        """Add a value at the time at_ns [ns], and return the minimum of the recent ones."""
        if self._now is None or at_ns - self._began_ns > _BLOCK_NS:
            self._before, self._now, self._began_ns = self._now, value, at_ns
        self._now = min(self._now, value)
        return self._now if self._before is None else min(self._now, self._before)


class SampleClock:
    """Relates a device's clock to that of the host by the fastest frames, as the link does between sites."""

    def __init__(self) -> None:
        self._last_us: int | None = None
        self._unwrapped_us = 0
        self._ahead = RecentMinimum()

    def host_ns(self, device_us: int, received_ns: int) -> int:
        """Return the time of a sample plus the shortest transit to the host [ns]; never later than its reception.

        Args:
            device_us: The time of the device [us], modulo 2^32, as the device sends it.
            received_ns: The time of reception on the clock of this process [ns].
        """
        step_us = 0 if self._last_us is None else (device_us - self._last_us) % _WRAP_US
        self._last_us = device_us
        self._unwrapped_us += step_us
        device_ns = self._unwrapped_us * 1000
        return device_ns + self._ahead.least(received_ns - device_ns, received_ns)

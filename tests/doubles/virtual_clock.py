"""A clock on which a test runs an hour in a millisecond."""


class VirtualClock:
    """A clock that only `advance_ns` moves."""

    def __init__(self, start_ns: int = 0, epoch_offset_ns: int = 0) -> None:
        self._monotonic_ns = start_ns
        self.epoch_offset_ns = epoch_offset_ns

    def monotonic_ns(self) -> int:
        return self._monotonic_ns

    def now_ns(self) -> int:
        return self._monotonic_ns + self.epoch_offset_ns

    def advance_ns(self, duration_ns: int) -> None:
        """Advance the clock; ValueError for a negative duration."""
        if duration_ns < 0:
            raise ValueError(f"duration_ns is {duration_ns}, must be 0 or more")
        self._monotonic_ns += duration_ns

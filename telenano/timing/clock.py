"""Clocks: the system clock, a virtual clock that its owner advances, and the clock of a node with a journal."""

import os
import time
from pathlib import Path
from typing import Protocol

from telenano.wire.errors import ConfigError

EPOCH_OFFSET_VARIABLE = "TELENANO_EPOCH_OFFSET_NS"
# A time that no clock reaches [ns].
NEVER_NS = 2**62


class Clock(Protocol):
    """The clock of a node.

    `epoch_offset_ns`: lead of message stamps over the monotonic clock [ns], constant for a process.
    """

    epoch_offset_ns: int

    def monotonic_ns(self) -> int:
        """Return the monotonic clock [ns]: deadlines and durations."""

    def now_ns(self) -> int:
        """Return the time for a message header [ns]: Unix epoch at the start, advanced by the monotonic clock."""


class SystemClock:
    """The clock of this machine.

    The epoch is read once and then advanced by the monotonic clock, so that the time never jumps. Processes inherit the
    offset of their supervisor through the environment, so that their time stamps are exactly comparable.
    """

    monotonic_ns = staticmethod(time.monotonic_ns)

    def __init__(self, epoch_offset_ns: int | None = None) -> None:
        if epoch_offset_ns is None:
            inherited = os.environ.get(EPOCH_OFFSET_VARIABLE)
            epoch_offset_ns = _inherited_ns(inherited) if inherited else time.time_ns() - time.monotonic_ns()
        self.epoch_offset_ns = epoch_offset_ns

    def now_ns(self) -> int:
        return time.monotonic_ns() + self.epoch_offset_ns


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
        """Advance the clock by a duration [ns]; raise ValueError if it is negative."""
        if duration_ns < 0:
            raise ValueError(f"duration_ns is {duration_ns}, must be 0 or more")
        self._monotonic_ns += duration_ns


class TurnClock:
    """The clock of a node with a journal of its inputs; it shows the time of the current turn."""

    def __init__(self, time_ns: int, epoch_offset_ns: int) -> None:
        self.time_ns = time_ns
        self.epoch_offset_ns = epoch_offset_ns

    def monotonic_ns(self) -> int:
        return self.time_ns - self.epoch_offset_ns

    def now_ns(self) -> int:
        return self.time_ns


def process_start_ns() -> int:
    """Return the start time of this process by the monotonic clock [ns], which is when a person gave its command.

    Systems without /proc return the time of this call.
    """
    now_ns = time.monotonic_ns()
    try:
        # The name in parentheses may have spaces; the 20th field after it is the start, in ticks since boot.
        ticks = int(Path("/proc/self/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[19])
        age_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) - ticks * 10**9 // os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError, AttributeError):
        return now_ns
    return now_ns - max(0, age_ns)


def _inherited_ns(text: str) -> int:
    try:
        return int(text)
    except ValueError as error:
        raise ConfigError(
            f"environment variable {EPOCH_OFFSET_VARIABLE} is {text!r}, must be an integer [ns]"
        ) from error

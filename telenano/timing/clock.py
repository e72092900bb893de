"""Clocks: the system's, one that only its owner advances, and that of a node whose inputs are journalled."""

import os
import time
from pathlib import Path
from typing import Protocol

from telenano.wire.errors import ConfigError

EPOCH_OFFSET_VARIABLE = "TELENANO_EPOCH_OFFSET_NS"
# a time on any clock that does not come [ns]
NEVER_NS = 2**62


class Clock(Protocol):
    """The clock of a node.

    `epoch_offset_ns`: by how much the time of a message header is ahead of the monotonic clock, constant for a process.
    """

    epoch_offset_ns: int

    def monotonic_ns(self) -> int:
        """Return the monotonic clock [ns]: deadlines and durations."""

    def now_ns(self) -> int:
        """Return the time for a message header [ns]: Unix epoch at the start, advanced by the monotonic clock."""


class SystemClock:
    """The clock of this machine.

    The epoch is read once and then advanced by the monotonic clock, so that the time never jumps. Processes that
    one supervisor starts inherit its offset through the environment: their time stamps are then exactly comparable.
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
        """Advance the clock; ValueError for a negative duration."""
        if duration_ns < 0:
            raise ValueError(f"duration_ns is {duration_ns}, must be 0 or more")
        self._monotonic_ns += duration_ns


class TurnClock:
    """The clock of a node whose inputs are journalled: it shows the time of the turn in hand."""

    def __init__(self, time_ns: int, epoch_offset_ns: int) -> None:
        self.time_ns = time_ns
        self.epoch_offset_ns = epoch_offset_ns

    def monotonic_ns(self) -> int:
        return self.time_ns - self.epoch_offset_ns

    def now_ns(self) -> int:
        return self.time_ns


def process_start_ns() -> int:
    """Return when this process was started, on the monotonic clock [ns]: when a person gave its command.

    It is the time of this call on a system that does not tell.
    """
    now_ns = time.monotonic_ns()
    try:
        # after the name in parentheses, which may have spaces: the 20th is the start, in ticks since the boot
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

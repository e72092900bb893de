"""What a node takes from the machine that it runs on, as its context gives it.

A session in virtual time passes another machine, so that its messages depend on no process id, no load and no memory.
"""

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from telenano.recording.disk import OWN_DISK, Disk

_STATM = Path("/proc/self/statm")


class Machine(Protocol):
    """A machine, as a node sees it.

    Attributes:
        disk: The disk that the node writes recordings to.
    """

    disk: Disk

    def token(self, size_bytes: int) -> str:
        """Return a number that no other process draws, in hexadecimal digits, two for each byte."""

    def processor_time_s(self) -> float:
        """Return the processor time that this process has taken [s]."""

    def health(self, processor_s: float, elapsed_s: float) -> Mapping[str, Any]:
        """Return the fields of node/health that tell of the machine and of this process.

        A field of health that differs between machines or runs belongs here, and to no other place: the machine of a
        session in virtual time leaves it out, unless the message requires it.

        Args:
            processor_s: The processor time that was taken since the last report [s].
            elapsed_s: The time since the last report [s].
        """


class OwnMachine:
    """The machine that this process runs on."""

    def __init__(self, disk: Disk = OWN_DISK) -> None:
        self.disk = disk

    def token(self, size_bytes: int) -> str:
        return os.urandom(size_bytes).hex()

    def processor_time_s(self) -> float:
        return time.process_time()

    def health(self, processor_s: float, elapsed_s: float) -> Mapping[str, Any]:
        return {
            "pid": os.getpid(),
            "cpu_percent": 100.0 * max(0.0, processor_s) / elapsed_s,
            "memory_bytes": resident_bytes(),
        }


class SharedMachine(OwnMachine):
    """The machine as one of several nodes of a process sees it: what that process takes is what all of them tell.

    Args:
        others: The other nodes of the process.
    """

    def __init__(self, others: Sequence[str]) -> None:
        super().__init__()
        self._others = tuple(others)

    def health(self, processor_s: float, elapsed_s: float) -> Mapping[str, Any]:
        return {**super().health(processor_s, elapsed_s), "shares_with": self._others}


def resident_bytes() -> int:
    """Return the resident memory of this process [bytes], 0 where it has no descriptor left to look."""
    try:
        return int(_STATM.read_bytes().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


OWN_MACHINE = OwnMachine()

"""The machine of a node, as an argument of its context: random numbers, processor time, memory, disk.

A session in virtual time passes another machine, so that its messages depend on no process id, load or memory.
"""

import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from telenano.recording.disk import OWN_DISK, Disk
from telenano.runtime.bus.open_files import descriptor_limit, open_descriptors

_STATM = Path("/proc/self/statm")


class Machine(Protocol):
    """The interface of a machine for a node.

    Attributes:
        disk: The disk to which the node writes recordings.
    """

    disk: Disk

    def token(self, size_bytes: int) -> str:
        """Return a random number of `size_bytes` bytes in hexadecimal digits, unique to this process."""

    def processor_time_s(self) -> float:
        """Return the processor time that this process has used [s]."""

    def health(self, processor_s: float, elapsed_s: float) -> Mapping[str, Any]:
        """Return the fields of node/health on the machine and this process.

        All fields of health that differ between machines or runs belong here: the machine of a session in virtual time
        omits them, unless the message requires them.

        Args:
            processor_s: The processor time used since the last report [s].
            elapsed_s: The time since the last report [s].
        """


class OwnMachine:
    """The machine on which this process runs."""

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
            "open_files": open_descriptors(),
            "most_open_files": descriptor_limit(),
        }


class SharedMachine(OwnMachine):
    """The machine for one of several nodes of a process; each of them reports the use of the whole process.

    Args:
        others: The other nodes of the process, which the report names.
    """

    def __init__(self, others: Sequence[str]) -> None:
        super().__init__()
        self._others = tuple(others)

    def health(self, processor_s: float, elapsed_s: float) -> Mapping[str, Any]:
        return {**super().health(processor_s, elapsed_s), "shares_with": self._others}


def resident_bytes() -> int:
    """Return the resident memory of this process [bytes], 0 if it cannot be read, as without a free descriptor."""
    try:
        return int(_STATM.read_bytes().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


OWN_MACHINE = OwnMachine()

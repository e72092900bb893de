"""The open files of this process and their limit; without models, because every kind of process counts them."""

import sys
from pathlib import Path

from telenano.files.optional_modules import optional_module

# Windows has no such module.
resource = optional_module("resource")
_OPEN = Path("/proc/self/fd")
_ELSEWHERE = Path("/dev/fd")


def open_descriptors() -> int | None:
    """Return the number of open files of this process; None if the system does not tell."""
    try:
        # Linux from 6.2 on states the number as the size of the folder, for which no descriptor is needed.
        if sys.platform == "linux" and (count := _OPEN.stat().st_size):
            return count
        return sum(1 for _ in _ELSEWHERE.iterdir()) - 1
    except OSError:
        return None


def listed_descriptors() -> list[int]:
    """Return the open descriptors of this process in their order; without one left to list them, all possible ones."""
    try:
        return sorted(int(entry.name) for entry in _OPEN.iterdir())
    except OSError:
        return list(range(open_descriptors() or 0))


def descriptor_limit() -> int | None:
    """Return the limit of open files of this process; None if there is none."""
    if resource is None or sys.platform == "win32":
        return None
    limit: int = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return None if limit == resource.RLIM_INFINITY else limit

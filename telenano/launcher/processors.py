"""Exclusive processors for a rig: a file lock for each, which the kernel releases when the rig's last process ends.

Without them, two rigs that share processors reach three quarters of their rate while other processors are idle. The
locks are in a folder that all users of the machine share, because they share the processors.
"""

import contextlib
import os
import tempfile
import time
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from telenano.files.optional_modules import optional_module

# Windows lacks this module; no rig runs its processes there.
fcntl = optional_module("fcntl")
# Number of processors of a rig: one for the hand's side and one for the instrument's.
FOR_A_RIG = 2
_SHARED = Path("/run/lock")
# Longest time that a rig waits for its turn to claim processors [s].
_TURN_WAIT_S = 1.0
# Interval between attempts to get the lock of the turn [s].
_TURN_LOOK_S = 0.005
# O_NONBLOCK: opening a pipe that another user placed there must not block the start of a rig.
_OPEN = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0)


def shared_folder() -> Path:
    """Return the folder of the locks, which every user of this machine can write to."""
    return _SHARED if os.access(_SHARED, os.W_OK) else Path(tempfile.gettempdir())


def claim(count: int, usable: Collection[int], folder: Path) -> dict[int, int]:
    """Lock `count` of the usable processors, highest numbers first, or none if fewer are free.

    The highest come first because the first processors tend to serve the machine's interrupts.

    Args:
        count: The number of processors that the rig needs.
        usable: The processors to choose from.
        folder: The folder of the locks.

    Returns:
        A descriptor for each processor; its lock lasts until all copies of the descriptor are closed. Empty if none.
    """
    locks: dict[int, int] = {}
    with _turn(folder):
        for processor in sorted(usable, reverse=True):
            if len(locks) < count and (descriptor := _locked(_file(folder, processor))) is not None:
                locks[processor] = descriptor
    if len(locks) < count:
        release(locks)
        return {}
    return locks


def claim_these(wanted: Collection[int], folder: Path) -> dict[int, int]:
    """Lock those of the wanted processors that are free; return a descriptor for each, as `claim` does."""
    with _turn(folder):
        locks = {processor: _locked(_file(folder, processor)) for processor in sorted(set(wanted))}
    return {processor: descriptor for processor, descriptor in locks.items() if descriptor is not None}


def held(numbers: Collection[int], folder: Path) -> tuple[int, ...]:
    """Return those of some processors that rigs hold now, sorted."""
    free = claim_these(numbers, folder)
    release(free)
    return tuple(sorted(set(numbers) - set(free)))


def fits_text(free: int) -> str:
    """Return a sentence with the number of further rigs for which the free processors suffice."""
    rigs = free // FOR_A_RIG
    beyond = "a further rig shares processors with them, and may not reach its rate"
    return f"{free} free, enough for {rigs} more rig{'' if rigs == 1 else 's'}" + ("" if rigs else f": {beyond}")


def release(claimed: Mapping[int, int]) -> None:
    """Release the locks of processors by closing their descriptors."""
    for descriptor in claimed.values():
        os.close(descriptor)


def _file(folder: Path, processor: int) -> Path:
    return folder / f"telenano-processor-{processor}.lock"


@contextlib.contextmanager
def _turn(folder: Path) -> Iterator[None]:
    """Let only one rig claim at a time; otherwise two that start together could each get only a part.

    After `_TURN_WAIT_S` the block runs without the lock.
    """
    descriptor, end_s = None, time.monotonic() + _TURN_WAIT_S
    # The wait is limited, so that a process of another user that keeps the lock cannot prevent the start of a rig.
    while (descriptor := _locked(folder / "telenano-processors.lock")) is None and time.monotonic() < end_s:
        time.sleep(_TURN_LOOK_S)
    try:
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _locked(path: Path) -> int | None:
    """Return a descriptor that holds the lock of a file; None if another process holds it or it cannot be opened."""
    try:
        # Check the type before opening, because opening a device file may cause an action of the device.
        if path.exists() and not path.is_file():
            return None
        descriptor = _opened(path)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def _opened(path: Path) -> int:
    """Open a lock file, creating it if absent.

    Another user may own it; in a shared folder the kernel then refuses an open with O_CREAT, so it is tried without.
    """
    with contextlib.suppress(FileNotFoundError):
        return os.open(path, _OPEN)
    with contextlib.suppress(FileExistsError):
        descriptor = os.open(path, _OPEN | os.O_CREAT | os.O_EXCL, 0o644)
        # All users have to be able to open it, independent of the umask of this one.
        os.fchmod(descriptor, 0o644)
        return descriptor
    return os.open(path, _OPEN)

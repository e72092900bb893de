"""Processors of a rig's own: a lock for each on this machine, which the kernel ends with the rig's last process.

Two rigs that share their processors reach three quarters of their rate, while others stand idle. The locks are in a
folder that all users of the machine have, because a processor is shared by all of them.
"""

import contextlib
import os
import tempfile
import time
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from telenano.files.optional_modules import optional_module

# Windows has no such module, and no processes of a rig.
fcntl = optional_module("fcntl")
# One for the hand's side and one for the instrument's; they meet at the link.
FOR_A_RIG = 2
_SHARED = Path("/run/lock")
# A rig waits for its turn to claim processors for this time at most.
_TURN_WAIT_S = 1.0
# The lock of the turn is tried at this interval.
_TURN_LOOK_S = 0.005
# A pipe that another user puts there must not keep a rig from starting.
_OPEN = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NONBLOCK", 0)


def shared_folder() -> Path:
    """Return the folder of the locks, which every user of this machine can write to."""
    return _SHARED if os.access(_SHARED, os.W_OK) else Path(tempfile.gettempdir())


def permitted() -> set[int]:
    """Return the processors that this process may use."""
    return os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set(range(os.cpu_count() or 1))


def claim(count: int, usable: Collection[int], folder: Path) -> dict[int, int]:
    """Lock this many of some processors, the last ones first, or none where fewer are free.

    The first processors tend to serve the machine's interrupts.

    Args:
        count: How many the rig needs.
        usable: The processors to choose from.
        folder: The folder of the locks.

    Returns:
        A descriptor for each processor; the lock lasts until all copies of it are closed.
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
    """Lock those of some processors that are free; a descriptor for each, as by `claim`."""
    with _turn(folder):
        locks = {processor: _locked(_file(folder, processor)) for processor in sorted(set(wanted))}
    return {processor: descriptor for processor, descriptor in locks.items() if descriptor is not None}


def held(numbers: Collection[int], folder: Path) -> tuple[int, ...]:
    """Return which of some processors rigs hold now."""
    free = claim_these(numbers, folder)
    release(free)
    return tuple(sorted(set(numbers) - set(free)))


def fits_text(free: int) -> str:
    """Return in words how many rigs a number of free processors is enough for, and what a further one gets."""
    rigs = free // FOR_A_RIG
    beyond = "a further rig shares processors with them, and may not reach its rate"
    return f"{free} free, enough for {rigs} more rig{'' if rigs == 1 else 's'}" + ("" if rigs else f": {beyond}")


def release(claimed: Mapping[int, int]) -> None:
    """Let processors go."""
    for descriptor in claimed.values():
        os.close(descriptor)


def _file(folder: Path, processor: int) -> Path:
    return folder / f"telenano-processor-{processor}.lock"


@contextlib.contextmanager
def _turn(folder: Path) -> Iterator[None]:
    """Keep other rigs from claiming while the block runs: of two that start at once, each would get a part."""
    descriptor, end_s = None, time.monotonic() + _TURN_WAIT_S
    # A process of another user that keeps the turn must not keep a rig from starting.
    while (descriptor := _locked(folder / "telenano-processors.lock")) is None and time.monotonic() < end_s:
        time.sleep(_TURN_LOOK_S)
    try:
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _locked(path: Path) -> int | None:
    """Return a descriptor that holds the lock of a file; None where another process holds it, or it cannot be had."""
    try:
        # The check comes before opening, which a device may answer by an action.
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
    """Open a file that any user may have made: in a folder of all users the kernel refuses to make it again."""
    with contextlib.suppress(FileNotFoundError):
        return os.open(path, _OPEN)
    with contextlib.suppress(FileExistsError):
        descriptor = os.open(path, _OPEN | os.O_CREAT | os.O_EXCL, 0o644)
        # Whatever the mask of this user is, the others have to be able to open it.
        os.fchmod(descriptor, 0o644)
        return descriptor
    return os.open(path, _OPEN)

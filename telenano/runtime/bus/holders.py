"""The processes that hold the sockets of rigs, found through /proc, without knowing the folder or name of a rig.

for holder in look().holders:
    print(holder.node, holder.process, holder.path)

A process that binds an ipc endpoint holds a lock file (`endpoint_lock.py`), which contains its node and the path. The
lock stays open after its file was removed, so a process can run although its path is missing. Only processes of this
user are read, and the kernel lets no other user open files in their name. The module imports no models, because an
emergency stop has no time for them.
"""

import contextlib
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from telenano.runtime.bus.local_endpoint import folder_identity

# The signal for an emergency stop of a device whose socket cannot be reached; Windows has no such signal.
STOP_SIGNAL = getattr(signal, "SIGUSR2", None)
_PROC = Path("/proc")
_SUFFIX = ".lock"
_DELETED = " (deleted)"
_LARGEST_LOCK = 4096
# The inode number of the first PID namespace of the kernel; any other namespace is that of a container.
_FIRST_PID_NAMESPACE = 0xEFFFFFFC


class Holder(NamedTuple):
    """A process of this user that holds the lock of an ipc endpoint.

    `owner` is the id of the process that took the lock; it may have ended after passing the lock on to this one.
    `folders_of` is the inode number of the mount namespace of the holder, 0 if it is that of this process; it differs
    for example in a container. `takes_signal`: the holder obeys `STOP_SIGNAL`.
    """

    process: int
    owner: str
    node: str
    path: str
    folders_of: int = 0
    takes_signal: bool = False

    @property
    def folder(self) -> Path:
        """The folder of the socket, as seen by this process."""
        return Path(self.path_from_here).parent

    @property
    def rig(self) -> tuple[int, str]:
        """The identity of the rig: mount namespace and folder, the same for all its processes."""
        return self.folders_of, str(folder_identity(Path(self.path).parent))

    @property
    def path_from_here(self) -> str:
        """The path by which this process reaches the socket."""
        return f"/proc/{self.process}/root{self.path}" if self.folders_of else self.path

    def is_at(self, path: str) -> bool:
        """Return whether this holder holds the socket that this process reaches at a path."""
        mine, other = Path(self.path_from_here), Path(path)
        return mine.name == other.name and folder_identity(mine.parent) == folder_identity(other.parent)

    def signal_stop(self) -> bool:
        """Send the process an emergency stop as a signal; return whether it could be sent and has a handler."""
        if STOP_SIGNAL is None or not self.takes_signal:
            return False
        try:
            descriptor = os.pidfd_open(self.process)
        except (OSError, AttributeError):
            return False
        try:
            # The process id may now belong to another process, which the signal would kill.
            if not any(held.node == self.node for held in _held_by(self.process)) or not _takes_signal(self.process):
                return False
            signal.pidfd_send_signal(descriptor, STOP_SIGNAL)
        except OSError:
            return False
        finally:
            os.close(descriptor)
        return True


class Look(NamedTuple):
    """The holders found; `blind` says why there may be others, empty if there cannot be any."""

    holders: tuple[Holder, ...] = ()
    blind: str = ""

    def at(self, path: str) -> list[Holder]:
        """Return the holders of the socket that this process reaches at a path."""
        return [holder for holder in self.holders if holder.is_at(path)]


def look() -> Look:
    """Return the processes of this user that hold ipc endpoints of nodes."""
    if not (_PROC / "self" / "fd").exists():
        return Look((), "this system has no /proc, which lists the processes")
    found: list[Holder] = []
    closed = []
    for process in _candidates():
        try:
            found += _held_by(process)
        except PermissionError:
            if _is_of_project(process):
                closed.append(str(process))
        except OSError:
            # The process has ended meanwhile.
            continue
    reasons = [f"process {', '.join(closed)} of this user cannot be looked into"] if closed else []
    if _in_container():
        reasons.append("the processes outside of this container are not seen")
    return Look(tuple(found), "; ".join(reasons))


def _candidates() -> Iterator[int]:
    """Return the processes of this user that may hold locks: those that took one, and those of the project.

    The latter may have inherited a lock from a launcher that has ended. If the kernel does not list the locks, all
    processes of this user are returned.
    """
    try:
        rows = [line.split() for line in (_PROC / "locks").read_text().splitlines()]
        takers = {row[4] for row in rows if len(row) > 4 and row[1] == "FLOCK"}
    except OSError:
        takers = None
    for number in (int(entry.name) for entry in _PROC.iterdir() if entry.name.isdigit()):
        may_hold = takers is None or str(number) in takers or _is_of_project(number)
        if may_hold and _user_of(number) == os.geteuid():
            yield number


def _held_by(process: int) -> list[Holder]:
    folder = _PROC / str(process)
    held = []
    for entry in (folder / "fd").iterdir():
        with contextlib.suppress(FileNotFoundError):
            target = str(entry.readlink()).removesuffix(_DELETED)
            if target.endswith(_SUFFIX) and _is_locked(folder / "fdinfo" / entry.name):
                held.append((entry, target))
    if not held:
        return []
    apart, takes_signal = _other_folders(folder), _takes_signal(process)
    found = []
    for place, target in held:
        with contextlib.suppress(FileNotFoundError):
            with place.open("rb") as file:
                lines = file.read(_LARGEST_LOCK).decode(errors="replace").splitlines()
            # A lock file of an earlier version contains only the process id; one on a full disk is empty.
            owner, node, path = (*(lines or [str(process)]), "", "")[:3]
            named = path or target.removesuffix(_SUFFIX)
            if owner.strip().isdigit():
                node = node or Path(named).name
                if "@" in node:
                    found.append(Holder(process, owner.strip(), node, named, apart, takes_signal))
    return found


def _is_locked(information: Path) -> bool:
    """Return whether a descriptor holds the lock of its file; one that only reads the file does not."""
    locks = [line.split() for line in information.read_text().splitlines() if line.startswith("lock:")]
    return any({"FLOCK", "WRITE"} <= set(words) for words in locks)


def _takes_signal(process: int) -> bool:
    """Return whether a process has a handler for the signal, which would kill it otherwise."""
    if STOP_SIGNAL is None:
        return False
    for line in (_PROC / str(process) / "status").read_text().splitlines():
        if line.startswith("SigCgt:"):
            return bool(int(line.split()[1], 16) >> (int(STOP_SIGNAL) - 1) & 1)
    return False


def _user_of(process: int) -> int | None:
    try:
        for line in (_PROC / str(process) / "status").read_text().splitlines():
            if line.startswith("Uid:"):
                return int(line.split()[2])
    except (OSError, ValueError):
        pass
    return None


def _other_folders(folder: Path) -> int:
    """Return the inode number of the mount namespace of a process, 0 if it is that of this one or unknown."""
    try:
        own, other = (_PROC / "self" / "ns" / "mnt").stat(), (folder / "ns" / "mnt").stat()
    except OSError:
        return 0
    return 0 if os.path.samestat(own, other) else other.st_ino


def _is_of_project(process: int) -> bool:
    try:
        words = (_PROC / str(process) / "cmdline").read_bytes()
    except OSError:
        return False
    return b"telenano" in words or b"services." in words


def _in_container() -> bool:
    try:
        return (_PROC / "self" / "ns" / "pid").stat().st_ino != _FIRST_PID_NAMESPACE
    except OSError:
        return False

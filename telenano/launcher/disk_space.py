"""Checks that the disks a rig writes to have room for its start and are writable, before any process is started."""

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from telenano.launcher.files_for_nodes import named_bytes
from telenano.launcher.plan import Plan
from telenano.recording.recorder_config import RecorderConfig
from telenano.runtime.bus.local_endpoint import runtime_directory
from telenano.wire.errors import RigError

# Files in the runtime directory: socket, lock, and inlet for emergency stops of a node; lock of the name of a rig, and
# the file in which it describes itself.
_FILES_OF_A_NODE, _FILES_OF_A_RIG = 4, 2


def check_room(plan: Plan, status: Callable[[Path], os.statvfs_result] = os.statvfs) -> None:
    """Check the free space and the permissions of each folder that a rig writes to.

    Args:
        plan: The planned rig.
        status: Returns the file system statistics of a folder, as `os.statvfs` does.

    Raises:
        RigError: A folder has no room for the start or cannot be written to; the message names folder and reason.
    """
    for folder, what, needed, files in _needs(plan):
        place = next((each for each in (folder, *folder.absolute().parents) if each.exists()), folder)
        if not place.is_dir():
            raise RigError(f"{place}: is not a folder, and {what} there: name another one")
        if not os.access(place, os.W_OK | os.X_OK):
            raise RigError(f"{place}: this user may not write there, and {what} there: chmod it, or name another one")
        try:
            disk = status(place)
        except OSError:
            # The first write to this folder will report the fault.
            continue
        if disk.f_flag & os.ST_RDONLY:
            raise RigError(f"{place}: its disk is mounted read-only, and {what} there: name another one")
        block = disk.f_frsize or 1
        room, needed = disk.f_bavail * block, -(-needed // block) * block + files * block
        if room < needed:
            raise RigError(
                f"{place}: its disk has {_kilobytes(room)} left, and {what} there, which takes {_kilobytes(needed)} at "
                "the start: remove something, or name another one"
            )
        # A file system without an inode table, such as btrfs, reports 0 of 0 files.
        if disk.f_files and disk.f_favail < files:
            raise RigError(
                f"{place}: its disk takes {disk.f_favail} more files, and {what} there, which are {files}: remove "
                "something, or name another one"
            )


def _needs(plan: Plan) -> Iterator[tuple[Path, str, int, int]]:
    """Yield for each folder its path, its use in words, the bytes written at the start, and the number of files."""
    if plan.nodes:
        recorder = plan.loaded.section("recorder", RecorderConfig)
        records = any(node.startswith("recorder@") for node in plan.nodes)
        size = len(plan.scenario_bytes) + (recorder.chunk_size_bytes if records else 0)
        yield plan.out, "the session is recorded", size, len(plan.nodes) + 3
        yield _temporary_folder(), "copies of files that vanish are made", named_bytes(plan), 1
    if plan.book.uses_runtime_directory:
        files = _FILES_OF_A_NODE * (len(plan.nodes) + 1) + _FILES_OF_A_RIG
        yield runtime_directory(), "the sockets of the rig are made", 0, files


def _temporary_folder() -> Path:
    try:
        return Path(tempfile.gettempdir())
    except OSError as error:
        raise RigError(f"there is no folder for temporary files that can be written to: {error.strerror}") from error


def _kilobytes(size: int) -> str:
    return f"{size / 1e3:.0f} kB"

"""Whether the disks that a rig writes to have room for its start, and may be written to, before anything is started."""

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from telenano.launcher.files_for_nodes import named_bytes
from telenano.launcher.plan import Plan
from telenano.recording.recorder_config import RecorderConfig
from telenano.runtime.bus.local_endpoint import runtime_directory
from telenano.wire.errors import RigError

# A socket, its lock, and the inlet for emergency stops of a node, and the name of the rig with what it says of itself.
_FILES_OF_A_NODE, _FILES_OF_A_RIG = 4, 2


def check_room(plan: Plan, status: Callable[[Path], os.statvfs_result] = os.statvfs) -> None:
    """Look at the folders that a rig writes to.

    Args:
        plan: The planned rig.
        status: Returns what a disk says of itself.

    Raises:
        RigError: One has no room for the start, or cannot be written to; the message names it and what it lacks.
    """
    for folder, what, needed, files in _needs(plan):
        place = next((each for each in (folder, *folder.absolute().parents) if each.exists()), folder)
        if not place.is_dir():
            raise RigError(f"{place}: is no folder, and {what} there: name another one")
        if not os.access(place, os.W_OK | os.X_OK):
            raise RigError(f"{place}: this user may not write there, and {what} there: chmod it, or name another one")
        try:
            disk = status(place)
        except OSError:
            # What writes there first reports it.
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
        # A disk without a table of files, such as btrfs, says 0 of 0.
        if disk.f_files and disk.f_favail < files:
            raise RigError(
                f"{place}: its disk takes {disk.f_favail} more files, and {what} there, which are {files}: remove "
                "something, or name another one"
            )


def _needs(plan: Plan) -> Iterator[tuple[Path, str, int, int]]:
    """Yield each folder with what is written there, in words, the bytes of it, and the number of files."""
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

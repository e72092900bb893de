"""Identify a file that this process has made, even if another file has replaced it at its path."""

import contextlib
import os
from pathlib import Path

# The flag to open files that cannot be read, such as sockets; only Linux has it, and it is not needed elsewhere.
_PATH_ONLY = getattr(os, "O_PATH", 0)


class Pin:
    """Keeps the inode of a file open until `close`, so that no later file gets the same inode number."""

    def __init__(self, path: Path) -> None:
        """Open the file at the path; raise OSError if there is none."""
        self._path = path
        self._status = path.lstat()
        self._descriptor: int | None = None
        if _PATH_ONLY:
            self._descriptor = os.open(path, _PATH_ONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
            self._status = os.fstat(self._descriptor)

    def is_in_place(self) -> bool:
        """Return whether the file is still at the path."""
        try:
            return os.path.samestat(self._status, self._path.lstat())
        except OSError:
            return False

    def remove(self) -> None:
        """Remove the file if it is still at the path, and close the inode."""
        if self.is_in_place():
            with contextlib.suppress(OSError):
                self._path.unlink()
        self.close()

    def close(self) -> None:
        """Close the inode, and leave the file alone."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

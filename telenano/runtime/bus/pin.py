"""A file that this process has made, told from another one that stands at its path by now."""

import contextlib
import os
from pathlib import Path

# It opens what cannot be read, such as a socket; other systems than Linux have it not, and open no socket.
_PATH_ONLY = getattr(os, "O_PATH", 0)


class Pin:
    """Keeps the inode of a file open, so that no later file has its number, until it is closed."""

    def __init__(self, path: Path) -> None:
        """Take what stands at the path; OSError where that is nothing."""
        self._path = path
        self._status = path.lstat()
        self._descriptor: int | None = None
        if _PATH_ONLY:
            self._descriptor = os.open(path, _PATH_ONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
            self._status = os.fstat(self._descriptor)

    def is_in_place(self) -> bool:
        """Return whether the file is still what stands at the path."""
        try:
            return os.path.samestat(self._status, self._path.lstat())
        except OSError:
            return False

    def remove(self) -> None:
        """Remove the file, if it is still what stands at the path, and close this."""
        if self.is_in_place():
            with contextlib.suppress(OSError):
                self._path.unlink()
        self.close()

    def close(self) -> None:
        """Leave the file alone from now on."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

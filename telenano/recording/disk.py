"""The disk that recordings are written to: the one of this machine, or one in memory.

    disk = MemoryDisk()
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=Path("out")), disk=disk)
    disk.read(Path("out/session.mcap"))

A disk in memory keeps its files for as long as the object exists.
"""

import io
import os
from pathlib import Path
from typing import IO, Protocol

from telenano.recording.disk_watch import free_bytes

# Device and inode of a file; a file in memory has 0 and a running number.
Identity = tuple[int, int]


class Disk(Protocol):
    """File operations that a recorder needs. Every method passes on the OSError of the operating system."""

    def create(self, path: Path) -> IO[bytes]:
        """Create a file and the folders above it; raise FileExistsError if it exists."""

    def is_folder(self, path: Path) -> bool:
        """Return whether a path is a folder."""

    def identity(self, stream: IO[bytes]) -> Identity:
        """Return the identity of the file to which an open stream writes."""

    def identity_at(self, path: Path) -> Identity:
        """Return the identity of the file that now has a path; raise FileNotFoundError if there is none."""

    def sync(self, stream: IO[bytes]) -> None:
        """Wait until everything written to a stream is on the disk."""

    def remove(self, path: Path) -> None:
        """Remove a file; one that is gone already is no error."""

    def named(self, path: Path) -> Path:
        """Return the path of a file that a recorder reports to others."""

    def free_bytes(self, path: Path) -> int | None:
        """Return the free space at the place of a file or folder [bytes], existing or not; None if unknown."""


class OwnDisk:
    """The disk of this machine."""

    def create(self, path: Path) -> IO[bytes]:
        path.parent.mkdir(parents=True, exist_ok=True)
        return path.open("xb")

    def is_folder(self, path: Path) -> bool:
        return path.is_dir()

    def identity(self, stream: IO[bytes]) -> Identity:
        status = os.fstat(stream.fileno())
        return status.st_dev, status.st_ino

    def identity_at(self, path: Path) -> Identity:
        status = path.stat()
        return status.st_dev, status.st_ino

    def sync(self, stream: IO[bytes]) -> None:
        os.fdatasync(stream.fileno())

    def remove(self, path: Path) -> None:
        path.unlink(missing_ok=True)

    def named(self, path: Path) -> Path:
        return path.absolute()

    def free_bytes(self, path: Path) -> int | None:
        return free_bytes(path)


class _KeptFile(io.BytesIO):
    """A file in memory, which keeps its bytes when it is closed."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number
        self.kept = b""

    def close(self) -> None:
        if not self.closed:
            self.kept = self.getvalue()
        super().close()

    def bytes_now(self) -> bytes:
        return self.kept if self.closed else self.getvalue()


class MemoryDisk:
    """A disk in memory; `free_bytes` reports the rest of `room_bytes` [bytes], or None if there is no such limit."""

    def __init__(self, room_bytes: int | None = None) -> None:
        self._files: dict[Path, _KeptFile] = {}
        self._made = 0
        self._room_bytes = room_bytes

    @property
    def paths(self) -> tuple[Path, ...]:
        """The paths of the files, in order of creation."""
        return tuple(self._files)

    def read(self, path: Path) -> bytes:
        """Return the content of a file; raise FileNotFoundError if there is none."""
        return self._file(path).bytes_now()

    def create(self, path: Path) -> IO[bytes]:
        place = path.absolute()
        if place in self._files:
            raise FileExistsError(f"{path} exists already")
        self._made += 1
        self._files[place] = _KeptFile(self._made)
        return self._files[place]

    def is_folder(self, path: Path) -> bool:
        return path.absolute() not in self._files

    def identity(self, stream: IO[bytes]) -> Identity:
        assert isinstance(stream, _KeptFile)
        return 0, stream.number

    def identity_at(self, path: Path) -> Identity:
        return 0, self._file(path).number

    def sync(self, stream: IO[bytes]) -> None:
        """Do nothing: memory has no buffer to wait for."""

    def remove(self, path: Path) -> None:
        self._files.pop(path.absolute(), None)

    def named(self, path: Path) -> Path:
        return path.absolute()

    def free_bytes(self, path: Path) -> int | None:
        if self._room_bytes is None:
            return None
        return max(0, self._room_bytes - sum(len(file.bytes_now()) for file in self._files.values()))

    def _file(self, path: Path) -> _KeptFile:
        if (file := self._files.get(path.absolute())) is None:
            raise FileNotFoundError(f"{path}: there is no such file on this disk in memory")
        return file


class FolderDisk:
    """A folder of another disk as a disk of its own: messages name files by their paths relative to the folder.

    Messages thus do not depend on the folder's location. Nor on the free space of this machine's disk, which differs
    between runs and is reported as unknown.
    """

    def __init__(self, folder: Path, disk: Disk) -> None:
        """Write to a folder of another disk."""
        self._folder, self._disk = folder, disk

    def create(self, path: Path) -> IO[bytes]:
        return self._disk.create(self._folder / path)

    def is_folder(self, path: Path) -> bool:
        return self._disk.is_folder(self._folder / path)

    def identity(self, stream: IO[bytes]) -> Identity:
        return self._disk.identity(stream)

    def identity_at(self, path: Path) -> Identity:
        return self._disk.identity_at(self._folder / path)

    def sync(self, stream: IO[bytes]) -> None:
        self._disk.sync(stream)

    def remove(self, path: Path) -> None:
        self._disk.remove(self._folder / path)

    def named(self, path: Path) -> Path:
        return path

    def free_bytes(self, path: Path) -> int | None:
        return None if isinstance(self._disk, OwnDisk) else self._disk.free_bytes(self._folder / path)


OWN_DISK = OwnDisk()

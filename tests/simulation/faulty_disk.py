"""Disks of the two recorders, in memory: they can be full or slow, lose their folder, or be cut in a write."""

import errno
import io
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

from telenano.recording.disk import Identity


class _File(io.BytesIO):
    """A file: flushed data outlast the process, and a part of the other data if the process is killed."""

    def __init__(self, disk: "FaultyDisk", site: str, number: int) -> None:
        super().__init__()
        self._disk, self.site, self.number = disk, site, number
        self.flushed = 0
        self.kept: bytes | None = None

    def write(self, data: Any) -> int:
        if self._disk.is_full(self.site):
            # The last write to a full disk is incomplete.
            super().write(bytes(data)[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)

    def flush(self) -> None:
        super().flush()
        if not self.closed:
            self.flushed = self.tell()
            self._disk.wait_for(self.site)

    def close(self) -> None:
        if not self.closed and self.kept is None:
            self.kept = self.getvalue()
        super().close()

    def torn(self, part: float) -> None:
        """Keep the flushed data and a part (0 to 1) of the rest, as after a kill."""
        whole = self.bytes_now()
        self.kept = whole[: self.flushed + round(part * (len(whole) - self.flushed))]
        super().close()

    def bytes_now(self) -> bytes:
        return self.getvalue() if self.kept is None else self.kept


class FaultyDisk:
    """The disks of both machines; files in the folder `far` are on the slave's machine."""

    def __init__(self, now_s: Callable[[], float], stall: Callable[[str, float], None]) -> None:
        """Begin without faults; `stall(node, time)` lets a recorder stand still for a time [s]."""
        self._now_s, self._stall = now_s, stall
        self.files: dict[Path, _File] = {}
        self._made = 0
        self._until_s: dict[tuple[str, str], float] = {}

    def begin(self, site: str, fault: str, for_s: float) -> None:
        """Begin a fault at a site for a time [s]; if the folder disappears, so do its files."""
        self._until_s[site, fault] = max(self._until_s.get((site, fault), 0.0), self._now_s() + for_s)
        if fault == "gone":
            for path in [path for path in self.files if _site(path) == site]:
                del self.files[path]

    def is_full(self, site: str) -> bool:
        return self._has(site, "full")

    def wait_for(self, site: str) -> None:
        """Let the recorder of a site wait if its disk is slow."""
        if self._has(site, "slow"):
            self._stall(f"recorder@{site}", 0.15)

    def tear(self, site: str, part: float) -> None:
        """Cut the open files of a site's recorder that was killed."""
        for path, file in self.files.items():
            if _site(path) == site and not file.closed:
                file.torn(part)

    def create(self, path: Path) -> IO[bytes]:
        place, site = path.absolute(), _site(path)
        if place in self.files:
            raise FileExistsError(errno.EEXIST, "File exists")
        if self._has(site, "gone"):
            raise FileNotFoundError(errno.ENOENT, "No such file or directory")
        if self.is_full(site):
            raise OSError(errno.ENOSPC, "No space left on device")
        self._made += 1
        self.files[place] = _File(self, site, self._made)
        return self.files[place]

    def is_folder(self, path: Path) -> bool:
        return path.absolute() not in self.files

    def identity(self, stream: IO[bytes]) -> Identity:
        assert isinstance(stream, _File)
        return 0, stream.number

    def identity_at(self, path: Path) -> Identity:
        if (file := self.files.get(path.absolute())) is None:
            raise FileNotFoundError(errno.ENOENT, "No such file or directory")
        return 0, file.number

    def sync(self, stream: IO[bytes]) -> None:
        """Do nothing: flushed data are permanent."""

    def remove(self, path: Path) -> None:
        self.files.pop(path.absolute(), None)

    def named(self, path: Path) -> Path:
        return path

    def free_bytes(self, path: Path) -> int | None:
        return 0 if self.is_full(_site(path)) else 1 << 34

    def write_out(self) -> None:
        """Write the files to the real disk, where they are read after the session."""
        for path, file in self.files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(file.bytes_now())

    def _has(self, site: str, fault: str) -> bool:
        return self._now_s() < self._until_s.get((site, fault), -1.0)


def _site(path: Path) -> str:
    return "slave" if "far" in path.parts else "master"

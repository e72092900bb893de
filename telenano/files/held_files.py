"""Files that a process holds for its child processes, so that a later restart of a child does not need the disk.

    held = HeldFiles()
    held.keep(Path("/home/me/site.yaml"), content)      # is read instead of the file
    held.keep_spare(Path("/home/me/dots.npy"), file)    # is read if the file is gone
    start([..., "--held", str(held.table)], pass_fds=held.descriptors)

    receive(held_descriptor)                            # in the child process
    open_regular(Path("/home/me/site.yaml"))            # as if it still existed

Contents are in memory (`memfd_create`), or in a file that is kept open, whose bytes outlive its name.
"""

import atexit
import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

_PRIVATE = 0o600


class _Entry(NamedTuple):
    descriptor: int
    # Whether it is read even if a file exists at the path.
    is_fixed: bool


class HeldFiles:
    """Contents of files, kept in memory for child processes that read them in place of the files at their paths.

    `table` is the file descriptor of the list of them, which a child reads by `receive`.
    """

    def __init__(self) -> None:
        self._entries: dict[str, _Entry] = {}
        self.table = _in_memory("held files")
        self._write_table()

    @property
    def descriptors(self) -> tuple[int, ...]:
        """The descriptors that a child process must inherit."""
        return (self.table, *(entry.descriptor for entry in self._entries.values()))

    def keep(self, path: Path, content: bytes, *, is_spare: bool = False) -> None:
        """Hold a content that children read instead of the file at a path; as a spare, only if that file is gone."""
        before = self._entries.get(str(path))
        descriptor = _in_memory(path.name) if before is None else before.descriptor
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, content, 0)
        self._entries[str(path)] = _Entry(descriptor, not is_spare)
        self._write_table()

    def keep_spare(self, path: Path, file: BinaryIO) -> None:
        """Hold a duplicate of an open file, which children read if the file is gone from its path."""
        if str(path) not in self._entries:
            self._entries[str(path)] = _Entry(os.dup(file.fileno()), is_fixed=False)
            self._write_table()

    def close(self) -> None:
        """Close all descriptors."""
        for descriptor in self.descriptors:
            os.close(descriptor)
        self._entries = {}

    def _write_table(self) -> None:
        text = json.dumps(self._entries).encode()
        os.ftruncate(self.table, 0)
        os.pwrite(self.table, text, 0)


_received: dict[str, _Entry] = {}
_copies: list[Path] = []


def receive(table: int) -> None:
    """Register the files that the parent process holds, from the descriptor of its table."""
    with _opened(table) as file:
        entries: Mapping[str, tuple[int, bool]] = json.loads(file.read())
    for path, (descriptor, is_fixed) in entries.items():
        os.set_inheritable(descriptor, False)
        _received[path] = _Entry(descriptor, is_fixed)


def opened(path: Path) -> BinaryIO | None:
    """Return the held content of a path, open for reading; None if the file itself is to be read."""
    entry = _received.get(str(path))
    if entry is None or (not entry.is_fixed and os.path.lexists(path)):
        return None
    return _opened(entry.descriptor)


def is_held(path: Path) -> bool:
    """Return whether a held content replaces the file at a path."""
    entry = _received.get(str(path))
    return entry is not None and (entry.is_fixed or not os.path.lexists(path))


def standing(path: Path) -> Path:
    """Return a path at which a file can be read: its own, or that of a temporary copy if its content is held.

    It is for libraries and other processes, which open files by path; `open_regular` needs no copy.
    """
    held = opened(path)
    if held is None:
        return path
    with held:
        folder = Path(tempfile.mkdtemp(prefix="telenano-held-"))
        if not _copies:
            atexit.register(_remove_copies)
        _copies.append(folder)
        with (folder / path.name).open("wb") as copy:
            shutil.copyfileobj(held, copy)
    return folder / path.name


def listed(folder: Path, suffix: str) -> list[Path]:
    """Return the files of a folder whose names end with a suffix, sorted, including those that are held for it."""
    found = set(folder.glob(f"*{suffix}"))
    found |= {path for text in _received if (path := Path(text)).parent == folder and path.name.endswith(suffix)}
    return sorted(found)


def _in_memory(name: str) -> int:
    if hasattr(os, "memfd_create"):
        descriptor = os.memfd_create(name)
    else:
        # Systems without memfd_create use an unlinked temporary file.
        with tempfile.TemporaryFile() as file:
            descriptor = os.dup(file.fileno())
    # The content may be a secret key, which only its owner may read.
    os.fchmod(descriptor, _PRIVATE)
    return descriptor


def _opened(descriptor: int) -> BinaryIO:
    file = Path(f"/dev/fd/{descriptor}").open("rb")  # noqa: SIM115
    # This may share the offset of another handle of the same open file.
    file.seek(0)
    return file


def _remove_copies() -> None:
    for folder in _copies:
        with contextlib.suppress(OSError):
            shutil.rmtree(folder)

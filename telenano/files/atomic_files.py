"""Results written whole or not at all: under a temporary name in the same folder, and renamed when they are complete.

A temporary name is hidden and says whose it is: `.NAME.MACHINE.PROCESS.part`. What a killed process has left behind
does not stand in the way of anything, and goes when the same result is written again on that machine.

A file that several processes change, such as a list of keys, is changed by `changed` alone: each reads what the one
before it has written, so that no change is lost.

    changed(folder / "allowed.yaml", lambda before: with_one_more(before or b""))
"""

import contextlib
import errno
import os
import platform
import re
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from telenano.files.optional_modules import optional_module
from telenano.wire.errors import RigError

# A change takes milliseconds, so a process that has had the lock for this long stands still [s].
LOCK_WAIT_S = 1.0
_RETRY_S = 0.005
# Windows has no such module, and no processes of a rig.
fcntl = optional_module("fcntl")
# There is no room, or none of it can be written.
WRITE_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
# A temporary name is that of a process, so that its threads write one after the other.
_one_thread = threading.Lock()
_SUFFIX = ".part"
# the temporary name of several files of one run
_RESULTS = "results"
# A name of this length stays, with machine and process, within the 255 bytes of a file system.
_LONGEST = 120


@contextlib.contextmanager
def atomic_file(path: Path, *, replace: bool = True) -> Iterator[Path]:
    """Yield the temporary path of a file that gets its name when the block ends, and is removed if it fails.

    A link is followed; a device or a pipe is written to as it is.

    Args:
        path: The path of the file.
        replace: Whether a file of that name is replaced.

    Raises:
        FileExistsError: A file of that name exists and is not to be replaced.
        OSError: The file cannot be written.
    """
    if replace and path.is_symlink():
        path = Path(os.path.realpath(path))
    if replace and path.exists() and not path.is_file() and not path.is_dir():
        _require_reader(path)
        yield path
        return
    with _temporary(path, path, replace=replace) as part:
        with _report_interruption(path):
            yield part
        if replace:
            part.replace(path)
        else:
            _name_once(part, path)


def _require_reader(path: Path) -> None:
    """Raise OSError for a pipe that nobody reads, whose writer would wait for a reader for ever."""
    if path.is_fifo():
        try:
            os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK))
        except OSError as error:
            text = "it is a pipe that nobody reads" if error.errno == errno.ENXIO else os.strerror(error.errno or 0)
            raise OSError(error.errno, text, str(path)) from error


def changed(
    path: Path,
    step: Callable[[bytes | None], bytes | None],
    *,
    read: Callable[[Path], bytes] = Path.read_bytes,
    mode: int = 0o600,
    is_forced: bool = True,
    wait_s: float = LOCK_WAIT_S,
) -> None:
    """Change a file that several processes share: one process at a time, and whole or not at all.

    Args:
        path: The file. `path.lock` beside it is the lock, and stays.
        step: What turns the content into the new one, None to leave the file as it is. It gets None where there is no
            file. Its own errors pass.
        read: What reads the file, and judges who else can change it.
        mode: Who may read and write the file, before the mask of this process is applied.
        is_forced: Whether the change is on the disk when this returns.
        wait_s: How long the lock is waited for [s].

    Raises:
        RigError: Another process has had the lock for `wait_s`, or the system refuses; the text names the file, which
            is as it was.
    """
    with locked(path, wait_s, mode=mode):
        try:
            before = None
            with contextlib.suppress(FileNotFoundError):
                before = read(path)
            if (after := step(before)) is not None and after != before:
                write_whole(path, after, mode, is_forced=is_forced)
        except OSError as error:
            raise RigError(f"{path}: cannot be changed: {error.strerror or error}") from error


@contextlib.contextmanager
def locked(path: Path, wait_s: float = LOCK_WAIT_S, *, mode: int = 0o600, busy: str = "") -> Iterator[None]:
    """Have a shared file alone while the block runs; a process that is killed has it no longer.

    Args:
        path: The file. `path.lock` beside it is the lock, and stays.
        wait_s: How long the lock is waited for [s].
        mode: Who may read and write the lock, before the mask of this process is applied.
        busy: What a person has to do where another process has it, in words; empty for ending that process.

    Raises:
        RigError: Another process has had it for `wait_s`, or the lock cannot be had for another reason, which the text
            states.
    """
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
    try:
        descriptor = os.open(f"{path}.lock", flags, mode)
    except OSError as error:
        raise RigError(f"{path}: cannot be locked: {error.strerror}") from error
    try:
        _lock(descriptor, path, wait_s, busy)
        yield
    finally:
        os.close(descriptor)


def write_whole(path: Path, content: bytes, mode: int = 0o600, *, is_forced: bool = True) -> None:
    """Write a file of one process whole or not at all; a link in its place is replaced, not followed.

    Raises:
        OSError: The file cannot be written.
    """
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
    with _one_thread, _temporary(path, path, replace=True) as part:
        with os.fdopen(os.open(part, flags, mode), "wb") as file:
            file.write(content)
            file.flush()
            if is_forced:
                os.fsync(file.fileno())
        part.replace(path)


def _lock(descriptor: int, path: Path, wait_s: float, busy: str) -> None:
    end_s = time.monotonic() + wait_s
    while fcntl is not None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        except BlockingIOError as error:
            if time.monotonic() >= end_s:
                text = busy or f"another process has had it for {wait_s:g} s: end that process"
                raise RigError(f"{path}: {text}") from error
            time.sleep(_RETRY_S)
        except OSError as error:
            raise RigError(f"{path}: cannot be locked: {error.strerror}") from error


@contextlib.contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Yield the temporary path of a new folder that gets its name when the block ends, and is removed if it fails.

    Raises:
        FileExistsError: The folder exists; the error names it.
        OSError: The folder cannot be written.
    """
    with _temporary(path, path, replace=False) as part:
        part.mkdir(parents=True)
        with _report_interruption(path):
            yield part
        part.rename(path)


@contextlib.contextmanager
def whole_results(path: Path, *, replace: bool = True) -> Iterator[Path]:
    """Yield a temporary folder whose files go into a folder, which may have others, when the block ends.

    If it fails the folder is as it was, and one that was not there is not there again. The temporary folder is in that
    folder, which may be all that this process can write to.

    Args:
        path: The path of the folder.
        replace: Whether files of the same names are replaced.

    Raises:
        FileExistsError: A file of one of the names exists and is not to be replaced.
        OSError: A file cannot be written.
    """
    with new_folder(path), _temporary(path / _RESULTS, path, replace=True) as part:
        part.mkdir()
        with _report_interruption(path):
            yield part
        names = sorted(entry.name for entry in part.iterdir())
        taken = [] if replace else [name for name in names if os.path.lexists(path / name)]
        if taken:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path / taken[0]))
        try:
            _move_into(part, path)
        except KeyboardInterrupt as error:
            # Only a few renames are left, so that the results of one run stay together.
            _move_into(part, path)
            error.add_note(f"{path} is complete")
            raise


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Make a folder where there is none, and remove it if it is empty when the block ends; OSError if it cannot be."""
    is_new = not path.exists()
    path.mkdir(parents=True, exist_ok=True)
    try:
        yield path
    finally:
        if is_new:
            with contextlib.suppress(OSError):
                path.rmdir()


@contextlib.contextmanager
def _report_interruption(path: Path) -> Iterator[None]:
    """Let an interruption of what makes a result say that it is lost, for who reports it."""
    try:
        yield
    except KeyboardInterrupt as error:
        error.add_note(f"{path} was not written")
        raise


def _move_into(part: Path, path: Path) -> None:
    for entry in sorted(part.iterdir()):
        entry.replace(path / entry.name)


@contextlib.contextmanager
def _temporary(path: Path, named: Path, *, replace: bool) -> Iterator[Path]:
    """Yield the temporary path of a result, after what killed processes have left of it was removed.

    An OSError names `named` instead of the temporary path, and where there is no room for what is written as well.
    """
    if not replace and os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
    # "." and ".." have no name of their own
    path = path if path.name not in ("", "..") else path.resolve()
    _remove_leftovers(path)
    part = path.with_name(f"{_stem(path)}{os.getpid()}{_SUFFIX}")
    _remove(part)
    try:
        yield part
    except OSError as error:
        beginning = str(part)
        if error.filename is None and error.errno in WRITE_ERRORS:
            # A write has no path in its error, as an opening has.
            error.filename = str(named)
        elif isinstance(error.filename, str) and error.filename.startswith(beginning):
            error.filename = f"{named}{error.filename.removeprefix(beginning)}"
        raise
    finally:
        try:
            _remove(part)
        except KeyboardInterrupt:
            _remove(part)
            raise


def _name_once(part: Path, path: Path) -> None:
    """Give a file its name unless there is one of that name by now."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:
        # The file system has no links.
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from None
        part.rename(path)


def _stem(path: Path) -> str:
    """Return the beginning of the temporary names of a result on this machine."""
    machine = re.sub(r"[^\w-]", "_", platform.node())[:_LONGEST]
    name = os.fsencode(path.name)[:_LONGEST].decode(errors="ignore")
    return f".{name}.{machine}."


def _remove_leftovers(path: Path) -> None:
    """Remove what processes of this machine that are no more have left of a result."""
    stem = _stem(path)
    with contextlib.suppress(OSError):
        for entry in path.parent.iterdir():
            process = entry.name.removeprefix(stem).removesuffix(_SUFFIX)
            if entry.name == f"{stem}{process}{_SUFFIX}" and process.isdecimal() and not _runs(int(process)):
                _remove(entry)


def _runs(process: int) -> bool:
    # Windows has no signal that only asks
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        pass
    return True


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)

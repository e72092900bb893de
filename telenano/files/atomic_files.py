"""Atomic writing of files: under a temporary name in the same folder, renamed when the file is complete.

A temporary name is hidden and names its owner: `.NAME.MACHINE.PROCESS.part`. Leftovers of a killed process do no harm;
they are removed when the same result is written again on that machine.

A file that several processes change, such as a list of keys, is changed only through `changed`: each process reads the
result of the previous one, so that no change is lost.

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

# A change takes milliseconds, so a process that holds the lock for this long must be stuck [s].
LOCK_WAIT_S = 1.0
_RETRY_S = 0.005
# Windows lacks this module, but does not run processes of a rig either.
fcntl = optional_module("fcntl")
# Errors of a write that mean a full or failing disk.
WRITE_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
# Temporary names are unique for a process only, so its threads write one after the other.
_one_thread = threading.Lock()
_SUFFIX = ".part"
# Name in the temporary name of a folder with several results.
_RESULTS = "results"
# With machine and process, a name of this length stays within the 255 bytes of a file system.
_LONGEST = 120


@contextlib.contextmanager
def atomic_file(path: Path, *, replace: bool = True) -> Iterator[Path]:
    """Yield a temporary path to write; the file gets its name when the block ends, and is removed if the block fails.

    A link is followed; a device or a pipe is written directly.

    Args:
        path: The path of the file.
        replace: Whether to replace a file of that name.

    Raises:
        FileExistsError: A file of that name exists and `replace` is False.
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
    """Raise OSError for a pipe without a reader, in which a writer would wait for ever."""
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
    """Change a file that several processes share, one process at a time and atomically.

    Args:
        path: The file. Its lock is `path.lock` beside it, which is not removed.
        step: Function from the old content (None without a file) to the new one, or None to leave the file unchanged.
            Its exceptions are passed on.
        read: Function that reads the file; it may also check who else can change it.
        mode: Permissions of the file, before the umask.
        is_forced: Whether to force the change to the disk before returning.
        wait_s: Longest wait for the lock [s].

    Raises:
        RigError: Another process holds the lock for `wait_s`, or the system refuses. The text names the file, which is
            unchanged.
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
    """Hold the lock of a shared file while the block runs; the system releases it if the process is killed.

    Args:
        path: The file. Its lock is `path.lock` beside it, which is not removed.
        wait_s: Longest wait for the lock [s].
        mode: Permissions of the lock file, before the umask.
        busy: Error text if another process holds the lock; empty for the advice to end that process.

    Raises:
        RigError: Another process holds the lock for `wait_s`, or locking fails; the text states the reason.
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
    """Write a file of a single process atomically; a link of that name is replaced, not followed.

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
    """Yield a temporary folder, which gets its name when the block ends and is removed if the block fails.

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
    """Yield a temporary folder, whose files are moved into `path` beside other files there when the block ends.

    If the block fails, `path` is unchanged, and removed if it is new. The temporary folder lies within `path`, because
    the process may have no other place to write to.

    Args:
        path: The path of the folder.
        replace: Whether to replace files of the same names.

    Raises:
        FileExistsError: A file of one of the names exists and `replace` is False.
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
            # Complete the few renames that are left, so that the results of one run stay together.
            _move_into(part, path)
            error.add_note(f"{path} is complete")
            raise


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Create a folder if it does not exist, or raise OSError; remove a new one if it is empty when the block ends."""
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
    """Add a note to a KeyboardInterrupt that the result was not written, for its report to the user."""
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
    """Yield the temporary path of a result, after removing the leftovers of killed processes.

    An OSError names `named` instead of the temporary path, and also if the disk is full.
    """
    if not replace and os.path.lexists(path):
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
    # "." and ".." are resolved to a path with a name.
    path = path if path.name not in ("", "..") else path.resolve()
    _remove_leftovers(path)
    part = path.with_name(f"{_stem(path)}{os.getpid()}{_SUFFIX}")
    _remove(part)
    try:
        yield part
    except OSError as error:
        beginning = str(part)
        if error.filename is None and error.errno in WRITE_ERRORS:
            # Unlike the error of open(), that of a write has no path.
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
    """Rename a temporary file; raise FileExistsError if a file of that name exists by now."""
    try:
        os.link(part, path)
    except FileExistsError:
        raise
    except OSError:
        # The file system has no hard links.
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from None
        part.rename(path)


def _stem(path: Path) -> str:
    """Return the part of a result's temporary name that is common to all processes of this machine."""
    machine = re.sub(r"[^\w-]", "_", platform.node())[:_LONGEST]
    name = os.fsencode(path.name)[:_LONGEST].decode(errors="ignore")
    return f".{name}.{machine}."


def _remove_leftovers(path: Path) -> None:
    """Remove the temporary files of a result whose processes on this machine no longer exist."""
    stem = _stem(path)
    with contextlib.suppress(OSError):
        for entry in path.parent.iterdir():
            process = entry.name.removeprefix(stem).removesuffix(_SUFFIX)
            if entry.name == f"{stem}{process}{_SUFFIX}" and process.isdecimal() and not _runs(int(process)):
                _remove(entry)


def _runs(process: int) -> bool:
    # Windows has no signal 0, which only tests for existence.
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

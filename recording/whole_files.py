"""Results written whole or not at all: under a temporary name in the same folder, and renamed when they are complete.

A temporary name is hidden and says whose it is: `.NAME.MACHINE.PROCESS.part`. What a killed process has left behind
does not stand in the way of anything, and goes when the same result is written again on that machine.
"""

import contextlib
import errno
import os
import platform
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

_SUFFIX = ".part"
# the temporary name of several files of one run
_RESULTS = "results"
# A name of this length stays, with machine and process, within the 255 bytes of a file system.
_LONGEST = 120


@contextlib.contextmanager
def whole_file(path: Path, *, replace: bool = True) -> Iterator[Path]:
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
        path = path.resolve()
    if replace and path.exists() and not path.is_file() and not path.is_dir():
        yield path
        return
    with _temporary(path, path, replace=replace) as part:
        with _said_when_interrupted(path):
            yield part
        if replace:
            part.replace(path)
        else:
            _name_once(part, path)


@contextlib.contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """Yield the temporary path of a new folder that gets its name when the block ends, and is removed if it fails.

    Raises:
        FileExistsError: The folder exists; the error names it.
        OSError: The folder cannot be written.
    """
    with _temporary(path, path, replace=False) as part:
        part.mkdir(parents=True)
        with _said_when_interrupted(path):
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
        with _said_when_interrupted(path):
            yield part
        names = sorted(found.name for found in part.iterdir())
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
def new_folder(path: Path) -> Iterator[None]:
    """Make a folder where there is none, and remove it if it is empty when the block ends; OSError if it cannot be."""
    is_new = not path.exists()
    path.mkdir(parents=True, exist_ok=True)
    try:
        yield
    finally:
        if is_new:
            with contextlib.suppress(OSError):
                path.rmdir()


@contextlib.contextmanager
def _said_when_interrupted(path: Path) -> Iterator[None]:
    """Let an interruption of what makes a result say that it is lost, for who reports it."""
    try:
        yield
    except KeyboardInterrupt as error:
        error.add_note(f"{path} was not written")
        raise


def _move_into(part: Path, path: Path) -> None:
    for found in sorted(part.iterdir()):
        found.replace(path / found.name)


@contextlib.contextmanager
def _temporary(path: Path, named: Path, *, replace: bool) -> Iterator[Path]:
    """Yield the temporary path of a result, after what killed processes have left of it was removed.

    An OSError names `named` instead of the temporary path.
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
        if isinstance(error.filename, str) and error.filename.startswith(beginning):
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
        for found in path.parent.iterdir():
            process = found.name.removeprefix(stem).removesuffix(_SUFFIX)
            if found.name == f"{stem}{process}{_SUFFIX}" and process.isdecimal() and not _runs(int(process)):
                _remove(found)


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

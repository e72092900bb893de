"""Reads and checks of files and folders that other users must not read or change: keys, allow list, socket folder."""

import contextlib
import os
from pathlib import Path

from telenano.files.held_files import is_held
from telenano.files.regular_files import NotRegularError, open_regular
from telenano.runtime.bus.local_endpoint import (
    MOST_RIG_LETTERS,
    RIG_VARIABLE,
    RUNTIME_DIRECTORY_VARIABLE,
    base_directory,
    is_rig_name,
    runtime_directory,
)
from telenano.wire.errors import ConfigError
from telenano.wire.printable import quoted

_ANY_ACCESS = 0o077
_CHANGE = 0o022
# Trusted files may belong to the user of this process, or to this one.
_ROOT = 0
# Most bytes of a file; a list of a thousand machines has a tenth of this size.
_LARGEST_BYTES = 1 << 20


def read_regular(path: Path) -> tuple[bytes, os.stat_result]:
    """Return content and status of a regular file; others, such as pipes, are refused, because reading may never end.

    Raises:
        ConfigError: It is a folder, pipe, socket or device, or larger than 1 MiB.
        OSError: The file cannot be read.
    """
    try:
        with open_regular(path) as file:
            content, status = file.read(_LARGEST_BYTES + 1), os.fstat(file.fileno())
    except (IsADirectoryError, NotRegularError) as error:
        raise ConfigError(f"{path}: is a folder, pipe, socket or device, must be a regular file") from error
    if len(content) > _LARGEST_BYTES:
        raise ConfigError(f"{path}: has more than {_LARGEST_BYTES} bytes, more than any key or list of keys")
    return content, status


def read_secret(path: Path) -> bytes:
    """Read a file with a secret; raise ConfigError if other users can read it, or change its folder."""
    return _read(path, _ANY_ACCESS, "read this secret key")


def read_trusted(path: Path) -> bytes:
    """Read a file that defines whom to trust; raise ConfigError if other users can change it, or its folder."""
    return _read(path, _CHANGE, "change it")


def _read(path: Path, forbidden: int, what: str) -> bytes:
    data, status = read_regular(path)
    _check(path, status, forbidden, what, "600")
    # A file that the parent process holds for this one may no longer exist on disk, and neither may its folder.
    if not is_held(path):
        check_folder_of_files(path.parent)
    return data


def check_folder_of_files(folder: Path) -> None:
    """Raise ConfigError if other users can replace the files of a folder, OSError if it is absent."""
    _check(folder, folder.stat(), _CHANGE, "change the files in it", "700")


def _check(path: Path, status: os.stat_result, forbidden: int, what: str, right: str) -> None:
    if status.st_uid not in (os.geteuid(), _ROOT):
        raise ConfigError(
            f"{path}: belongs to user {status.st_uid}, who can change it: chown {os.geteuid()} {quoted(path)}"
        )
    if status.st_mode & forbidden:
        mode = status.st_mode & 0o777
        raise ConfigError(f"{path}: other users can {what} (mode {mode:o}): chmod {right} {quoted(path)}")


def check_private_folder(folder: Path, remedy: str) -> None:
    """Raise ConfigError, with the remedy, if a folder belongs to another user or is open to others; it may be absent.

    A link counts as a folder of the user who made it, because any user can make links where all can write, as in /tmp.
    """
    user = os.geteuid()
    try:
        link = folder.lstat()
        # For a link of another user, the link itself is checked and refused: its target could change after the check.
        status = folder.stat() if link.st_uid in (user, _ROOT) else link
    except OSError:
        # A path that cannot be reached cannot be used either, and the code that uses it reports that.
        return
    owner = status.st_uid
    if owner != user:
        raise ConfigError(f"{folder}: belongs to user {owner}, and this is user {user}: {remedy}")
    if status.st_mode & _ANY_ACCESS:
        mode = status.st_mode & 0o777
        raise ConfigError(f"{folder}: other users can reach its content (mode {mode:o}): chmod 700 {quoted(folder)}")


def check_runtime_directory(*, make: bool = False) -> None:
    """Raise ConfigError if the folder of ipc sockets belongs to another user or is open to others.

    Another user who can write to it could impersonate any node.

    Args:
        make: Whether the folder is created first if it is absent.

    Raises:
        ConfigError: The folder belongs to another user, or is open to others.
    """
    if rig := os.environ.get(RIG_VARIABLE, ""):
        check_rig_name(rig)
    # The folder of a rig other than the first is in the folder of all rigs, so both are checked.
    for folder in dict.fromkeys((base_directory(), runtime_directory())):
        if make:
            # If the folder cannot be made, that is reported when a socket in it cannot be bound.
            with contextlib.suppress(OSError):
                folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        check_private_folder(folder, f"name another one by {RUNTIME_DIRECTORY_VARIABLE}")


def check_rig_name(text: str) -> str:
    """Return a text that is a valid name of a rig, else raise ConfigError: the name is part of each socket's path."""
    if not is_rig_name(text):
        raise ConfigError(
            f"--rig or {RIG_VARIABLE}: {text!r} cannot name a rig: a name has small letters, digits, - and _, "
            f"{MOST_RIG_LETTERS} at most, and begins with a letter or digit"
        )
    return text

"""The one way to open a file that a person names: a regular file of a bounded size.

A pipe without a writer would keep its reader for ever, a device may have no end or do something when it is opened, and
a file of many gigabytes would fill the memory before anything in it could be judged.
"""

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from telenano.files import held_files


class NotRegularError(OSError):
    """What stands at a path is a pipe, socket or device, or a link where none counts; `strerror` says it in words."""


def open_regular(path: Path, *, follows_links: bool = True) -> BinaryIO:
    """Open a regular file for reading, or what the process that started this one holds in its place.

    Args:
        path: The path of the file.
        follows_links: False for a file that this project alone writes, in whose place a link is none of it.

    Raises:
        OSError: The file cannot be opened.
        IsADirectoryError: It is a folder.
        NotRegularError: It is a pipe, a socket or a device, or a link and none is followed.
    """
    if (held := held_files.opened(path)) is not None:
        return held
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "its name has a character that no file can have", str(path))
    # The check comes before opening, which a device may answer by an action.
    _require_regular(path, path.stat(follow_symlinks=follows_links).st_mode)
    # Other systems have no such flags; a file that appears between the two calls must not keep this process.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    flags |= 0 if follows_links else getattr(os, "O_NOFOLLOW", 0)
    file = os.fdopen(os.open(path, flags), "rb")
    try:
        _require_regular(path, os.fstat(file.fileno()).st_mode)
    except OSError:
        file.close()
        raise
    return file


def read_regular(path: Path, most_bytes: int, *, follows_links: bool = True) -> bytes:
    """Return the content of a regular file; arguments as those of `open_regular`.

    Raises:
        OSError: The file cannot be read, or has more than most_bytes; its `strerror` then names both sizes.
    """
    with open_regular(path, follows_links=follows_links) as file:
        # A file that the kernel makes up while it is read states no size.
        content = file.read(most_bytes + 1)
        if len(content) > most_bytes:
            stated = max(os.fstat(file.fileno()).st_size, len(content))
            text = f"it has {stated} bytes, and at most {most_bytes} are read of such a file"
            raise OSError(errno.EFBIG, text, str(path))
    return content


def _is_own(status: os.stat_result) -> bool:
    """Return whether a file belongs to this user and no other user can write it, so that what is in it may be run."""
    return not hasattr(os, "getuid") or (status.st_uid == os.getuid() and not status.st_mode & 0o022)


def is_own(path: Path) -> bool:
    """Return whether no other user can write or replace a file or folder, so that what is in it may be run.

    Raises:
        OSError: It cannot be looked at.
    """
    return is_own_path(path) and (not path.exists() or _is_own(path.stat()))


def is_own_path(path: Path) -> bool:
    """Return whether only this user and root can replace a file or folder, which may be absent, or its parents.

    A folder in which only the owner of an entry can rename it, such as /tmp, counts as safe. So does one that the group
    can write whose number is that of the user, because that group has no other member.
    """
    if not hasattr(os, "getuid"):
        return True
    user = os.getuid()
    # Who owns a link, or the folder with it, decides what stands there: both ways are looked at.
    links = [path.absolute()] if path.is_symlink() else []
    for folder in {*links, *path.absolute().parents, *Path(os.path.realpath(path)).parents}:
        status = folder.lstat()
        others = 0o002 if status.st_gid == user else 0o022
        is_open = status.st_mode & others and not status.st_mode & stat.S_ISVTX and not stat.S_ISLNK(status.st_mode)
        if status.st_uid not in (user, 0) or is_open:
            return False
    return True


def _require_regular(path: Path, mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if stat.S_ISLNK(mode):
        raise NotRegularError(errno.ELOOP, "it is a link, and must be a regular file", str(path))
    if not stat.S_ISREG(mode):
        raise NotRegularError(errno.EINVAL, "it is a pipe, socket or device, and must be a regular file", str(path))

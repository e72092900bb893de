"""Opening of files that a person names, all through this module: only regular files of bounded size are opened.

A pipe without a writer would block its reader for ever, a device may be endless or act when it is opened, and a file of
many gigabytes would fill the memory before its content could be checked.
"""

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from telenano.files import held_files


class NotRegularError(OSError):
    """The path is a pipe, socket or device, or a link where none is allowed; `strerror` says so in a sentence."""


def open_regular(path: Path, *, follows_links: bool = True) -> BinaryIO:
    """Open a regular file for reading, or the content that the parent process holds for it (`held_files`).

    Args:
        path: The path of the file.
        follows_links: False for a file that only this project writes, which is never a link.

    Raises:
        OSError: The file cannot be opened.
        IsADirectoryError: It is a folder.
        NotRegularError: It is a pipe, a socket or a device, or a link and `follows_links` is False.
    """
    if (held := held_files.opened(path)) is not None:
        return held
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "its name has a character that no file can have", str(path))
    # Check before opening, because opening a device may trigger an action.
    _require_regular(path, path.stat(follow_symlinks=follows_links).st_mode)
    # O_NONBLOCK: a pipe that appears between the check and the call must not block. Some systems lack these flags.
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
    """Return the content of a regular file of at most `most_bytes`; path and links are treated as in `open_regular`.

    Raises:
        OSError: The file cannot be read, or is larger; `strerror` then names both sizes.
    """
    with open_regular(path, follows_links=follows_links) as file:
        # Read instead of asking for the size, because a virtual file of the kernel states none.
        content = file.read(most_bytes + 1)
        if len(content) > most_bytes:
            stated = max(os.fstat(file.fileno()).st_size, len(content))
            text = f"it has {stated} bytes, and at most {most_bytes} are read of such a file"
            raise OSError(errno.EFBIG, text, str(path))
    return content


def _is_own(status: os.stat_result) -> bool:
    """Return whether a file belongs to this user and no other user can write it, so that it is safe to run."""
    return not hasattr(os, "getuid") or (status.st_uid == os.getuid() and not status.st_mode & 0o022)


def is_own(path: Path) -> bool:
    """Return whether no other user can write or replace a file or folder, so that it is safe to run.

    Raises:
        OSError: Its status cannot be read.
    """
    return is_own_path(path) and (not path.exists() or _is_own(path.stat()))


def is_own_path(path: Path) -> bool:
    """Return whether only this user and root can replace a file or folder, which may be absent, or its parents.

    A sticky folder such as /tmp counts as safe, because only the owner of an entry can rename it. So does a folder
    writable by the group whose number is that of the user, because that group has no other member.
    """
    if not hasattr(os, "getuid"):
        return True
    user = os.getuid()
    # The owner of a link, or of its folder, can redirect it, so check the paths of both the link and its target.
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

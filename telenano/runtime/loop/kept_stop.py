"""An emergency stop kept in a file beside a device's inlet until the device is armed (ADR 0059).

The file contains the message itself, so that a device that finds it handles it like any other message: the stop is in
the device's journal and in the recording. The sender writes the file before it sends the stop, and the device when it
latches. So a device that was suspended for longer than senders repeat a message, or that was killed, starts again
latched, whichever program starts it. The module imports no models: an emergency stop has no time for them.
"""

import contextlib
from pathlib import Path

from telenano.files.atomic_files import write_whole
from telenano.files.regular_files import NotRegularError, read_regular

# A session/control of an emergency stop is far smaller.
_LARGEST = 4096


def keep(path: Path, payload: bytes) -> str:
    """Write a stop to the file, replacing an earlier one; return the reason if that is impossible, else "".

    The write is atomic, and does not follow a link at the path.
    """
    try:
        write_whole(path, payload, is_forced=False)
    except OSError as error:
        return f"{path}: the emergency stop cannot be kept: {error.strerror}"
    return ""


def kept(path: Path) -> bytes | None:
    """Return the kept stop, None if there is none, b"" if there is a file that cannot be read.

    Raises:
        NotRegularError: The path is a pipe, a socket, a device or a link, so it is no kept stop; `keep` replaces it.
        IsADirectoryError: The path is a folder, which `keep` cannot replace.
        OSError: Whether there is a file is not known, as on a broken disk.
    """
    try:
        return read_regular(path, _LARGEST, follows_links=False)
    except FileNotFoundError:
        return None
    except (NotRegularError, IsADirectoryError) as error:
        reason = f"{path}: {error.strerror}: no emergency stop is kept there; remove it"
        raise type(error)(error.errno, reason) from error
    except OSError:
        # This needs no descriptor and reads nothing, so a file is found even by a process that cannot open it.
        path.lstat()
        return b""


def forget(path: Path) -> None:
    """Remove the kept stop, because the device was armed or its rig has ended."""
    with contextlib.suppress(OSError):
        path.unlink()

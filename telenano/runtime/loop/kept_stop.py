"""An emergency stop in a file beside a device's inlet, until the device is armed (ADR 0059).

The file is the message itself, so that a device which finds it takes it as any other: it is in the journal of the
device and in the recording. The sender of a stop writes it before it sends, and the device when it latches. So a device
that was stopped for longer than anybody repeats a message, or that was killed, comes back latched, no matter what
started it. It imports no model: an emergency stop has no time for them.
"""

import contextlib
from pathlib import Path

from telenano.files.atomic_files import write_whole
from telenano.files.regular_files import NotRegularError, read_regular

# A session/control of an emergency stop is far smaller.
_LARGEST = 4096


def keep(path: Path, payload: bytes) -> str:
    """Keep a stop in the place of any before; return why that was not possible, empty where it was.

    A reader sees the whole file or none, and nothing is written through a link that somebody put there.
    """
    try:
        write_whole(path, payload, is_forced=False)
    except OSError as error:
        return f"{path}: the emergency stop cannot be kept: {error.strerror}"
    return ""


def kept(path: Path) -> bytes | None:
    """Return the stop that is kept, None where there is none; a file that cannot be read counts as an empty one.

    Raises:
        NotRegularError: A pipe, a socket, a device or a link stands there, which no stop was written to: whoever keeps
            one replaces it. IsADirectoryError means the same of a folder, in whose place none can be kept.
    """
    try:
        return read_regular(path, _LARGEST, follows_links=False)
    except FileNotFoundError:
        return None
    except (NotRegularError, IsADirectoryError):
        raise
    except OSError:
        return b""


def forget(path: Path) -> None:
    """Keep no stop any longer: the device was armed, or its rig has ended."""
    with contextlib.suppress(OSError):
        path.unlink()

"""Where the sockets of a rig are on this machine. It imports no model: an emergency stop has no time for models."""

import os
import socket
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

RUNTIME_DIRECTORY_VARIABLE = "TELENANO_RUNTIME_DIR"
# The rig that a process belongs to, or speaks to; a name is part of a path, and a path of a socket has 107 bytes.
RIG_VARIABLE = "TELENANO_RIG"
FIRST_RIG = "main"
MOST_RIG_LETTERS = 16
# sun_path holds 108 bytes on Linux, with its closing zero
LONGEST_IPC_PATH = 107
_RIG_FOLDER = "rig-"
_RUNTIME_PLACEHOLDER = "{runtime}"
_ESTOP_SUFFIX = ".estop"
_FAN_OUT_SUFFIX = ".fan"
_KEPT_SUFFIX = ".kept"


def runtime_directory() -> Path:
    """Return the private folder of the ipc sockets of the rig that TELENANO_RIG names, else of the first one."""
    return rig_directory(os.environ.get(RIG_VARIABLE, ""))


def rig_directory(rig: str) -> Path:
    """Return the private folder of a rig: that of this user for the first rig, one in it for each other."""
    base = base_directory()
    return base if rig in ("", FIRST_RIG) else base / f"{_RIG_FOLDER}{rig}"


def rigs_with_folders() -> list[str]:
    """Return the first rig, and each other that has a folder; whether one of them runs, its locks tell."""
    names = sorted(path.name.removeprefix(_RIG_FOLDER) for path in base_directory().glob(f"{_RIG_FOLDER}*"))
    return [FIRST_RIG, *(name for name in names if is_rig_name(name))]


def base_and_rig(folder: Path) -> tuple[Path, str]:
    """Return the folder of all rigs and the name of the rig whose folder this is, as `rig_directory` makes it."""
    name = folder.name.removeprefix(_RIG_FOLDER)
    is_beside = folder.name.startswith(_RIG_FOLDER) and is_rig_name(name)
    return (folder.parent, name) if is_beside else (folder, FIRST_RIG)


def is_rig_name(text: str) -> bool:
    """Return whether a text can name a rig: small letters, digits, - and _, at most 16."""
    letters = "abcdefghijklmnopqrstuvwxyz0123456789"
    return 0 < len(text) <= MOST_RIG_LETTERS and text[0] in letters and set(text) <= {*letters, "-", "_"}


def base_directory() -> Path:
    """Return the folder of all rigs of this user: TELENANO_RUNTIME_DIR, or one of this user's own."""
    named = os.environ.get(RUNTIME_DIRECTORY_VARIABLE)
    if named:
        return Path(named)
    user_directory = os.environ.get("XDG_RUNTIME_DIR")
    if user_directory:
        return Path(user_directory) / "telenano"
    import tempfile

    # Windows has no numbers of users, and a folder for temporary files for each of them
    number = f"-{os.getuid()}" if hasattr(os, "getuid") else ""
    return Path(tempfile.gettempdir()) / f"telenano{number}"


def local_endpoint(text: str) -> str:
    """Return the ipc endpoint that a site file gives as `text`."""
    return text.replace(_RUNTIME_PLACEHOLDER, str(runtime_directory()))


def path_of(endpoint: str) -> Path:
    """Return the path of an ipc endpoint."""
    return Path(endpoint.removeprefix("ipc://"))


def is_in_runtime_directory(text: str) -> bool:
    """Return whether an ipc endpoint of a site file is in the private folder."""
    return _RUNTIME_PLACEHOLDER in text


def estop_endpoint(endpoint: str) -> str:
    """Return where the node with an ipc endpoint takes emergency stops, from any number of senders."""
    return endpoint + _ESTOP_SUFFIX


def fan_out_endpoint(endpoint: str) -> str:
    """Return where observers of the node with an ipc endpoint connect, if its rig reads it once for all of them."""
    return endpoint + _FAN_OUT_SUFFIX


def remove_fan_out(endpoints: Iterable[str]) -> None:
    """Remove the sockets at which observers of nodes were served, where the process that served them has ended.

    One that a process has is that of another rig, which took the folder meanwhile.
    """
    for endpoint in endpoints:
        fan_out = fan_out_endpoint(endpoint)
        if not is_bound(fan_out):
            Path(fan_out.removeprefix("ipc://")).unlink(missing_ok=True)


def kept_stop_path(endpoint: str) -> Path:
    """Return the file that keeps an emergency stop for the device with an ipc endpoint until it is armed."""
    return Path(estop_endpoint(endpoint).removeprefix("ipc://") + _KEPT_SUFFIX)


class Peer(NamedTuple):
    """The process and the user that have a socket, by the kernel; `user` is None where the kernel did not say."""

    process: int
    user: int | None

    @property
    def is_trusted(self) -> bool:
        """Whether it is a process of this user or of root, or one in a folder that only they can write to."""
        return self.user is None or self.user in (os.geteuid(), 0)


def bound_by(endpoint: str) -> Peer | None:
    """Return who has an ipc endpoint; None where nobody does: a socket that was left behind does not answer."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(endpoint.removeprefix("ipc://"))
            process, user, _ = struct.unpack("3i", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        except BlockingIOError:
            # Another process has it, and is not fast enough to serve all that connect.
            return Peer(0, None)
        except OSError:
            return None
        except AttributeError:
            # This system has no SO_PEERCRED.
            return Peer(0, None)
    return Peer(process, user)


def is_bound(endpoint: str) -> bool:
    """Return whether a process has an ipc endpoint: a socket that a killed one left behind does not answer."""
    return bound_by(endpoint) is not None


def folder_identity(folder: Path) -> Path:
    """Return what two spellings of a folder have in common, whether or not it is there."""
    # The folders of a process in a container are behind a link that would be taken for one of this process.
    return folder if folder.parts[:2] == ("/", "proc") else folder.resolve()

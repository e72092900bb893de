"""Paths of the sockets of a rig on this machine. It imports no models: an emergency stop has no time for them."""

import os
import socket
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

RUNTIME_DIRECTORY_VARIABLE = "TELENANO_RUNTIME_DIR"
# Names the rig that a process belongs to or connects to. The name is part of socket paths, which have at most 107
# bytes, so it is short.
RIG_VARIABLE = "TELENANO_RIG"
FIRST_RIG = "main"
MOST_RIG_LETTERS = 16
# sun_path holds 108 bytes on Linux, including the terminating zero.
LONGEST_IPC_PATH = 107
_RIG_FOLDER = "rig-"
_RUNTIME_PLACEHOLDER = "{runtime}"
_ESTOP_SUFFIX = ".estop"
_FAN_OUT_SUFFIX = ".fan"
_KEPT_SUFFIX = ".kept"


def runtime_directory() -> Path:
    """Return the private folder of the ipc sockets of the rig that TELENANO_RIG names, else of the first rig."""
    return rig_directory(os.environ.get(RIG_VARIABLE, ""))


def rig_directory(rig: str) -> Path:
    """Return the private folder of a rig: that of this user for the first rig, a subfolder of it for each other."""
    base = base_directory()
    return base if rig in ("", FIRST_RIG) else base / f"{_RIG_FOLDER}{rig}"


def rigs_with_folders() -> list[str]:
    """Return the names of the first rig and of each other that has a folder; whether it runs, its locks tell."""
    names = sorted(path.name.removeprefix(_RIG_FOLDER) for path in base_directory().glob(f"{_RIG_FOLDER}*"))
    return [FIRST_RIG, *(name for name in names if is_rig_name(name))]


def base_and_rig(folder: Path) -> tuple[Path, str]:
    """Return the folder of all rigs and the name of the rig from the folder of one rig: inverts `rig_directory`."""
    name = folder.name.removeprefix(_RIG_FOLDER)
    is_beside = folder.name.startswith(_RIG_FOLDER) and is_rig_name(name)
    return (folder.parent, name) if is_beside else (folder, FIRST_RIG)


def is_rig_name(text: str) -> bool:
    """Return whether a text can name a rig: at most 16 of a-z, 0-9, - and _, the first one a letter or digit."""
    letters = "abcdefghijklmnopqrstuvwxyz0123456789"
    return 0 < len(text) <= MOST_RIG_LETTERS and text[0] in letters and set(text) <= {*letters, "-", "_"}


def base_directory() -> Path:
    """Return the folder of all rigs of this user: TELENANO_RUNTIME_DIR, else a folder of this user."""
    named = os.environ.get(RUNTIME_DIRECTORY_VARIABLE)
    if named:
        return Path(named)
    user_directory = os.environ.get("XDG_RUNTIME_DIR")
    if user_directory:
        return Path(user_directory) / "telenano"
    import tempfile

    # Windows has no user ids, and a separate folder for temporary files for each user.
    number = f"-{os.getuid()}" if hasattr(os, "getuid") else ""
    return Path(tempfile.gettempdir()) / f"telenano{number}"


def local_endpoint(text: str) -> str:
    """Return the ipc endpoint of a site file with its `{runtime}` replaced by the private folder."""
    return text.replace(_RUNTIME_PLACEHOLDER, str(runtime_directory()))


def path_of(endpoint: str) -> Path:
    """Return the path of an ipc endpoint."""
    return Path(endpoint.removeprefix("ipc://"))


def is_in_runtime_directory(text: str) -> bool:
    """Return whether an ipc endpoint of a site file is in the private folder."""
    return _RUNTIME_PLACEHOLDER in text


def estop_endpoint(endpoint: str) -> str:
    """Return the endpoint for emergency stops of the node with an ipc endpoint; any number of senders can connect."""
    return endpoint + _ESTOP_SUFFIX


def fan_out_endpoint(endpoint: str) -> str:
    """Return the endpoint for observers of the node with an ipc endpoint, if its rig reads the node once for all."""
    return endpoint + _FAN_OUT_SUFFIX


def remove_fan_out(endpoints: Iterable[str]) -> None:
    """Remove the sockets for observers of nodes whose serving process has ended.

    A socket that a process still holds is left alone: another rig uses the folder by now.
    """
    for endpoint in endpoints:
        fan_out = fan_out_endpoint(endpoint)
        if not is_bound(fan_out):
            Path(fan_out.removeprefix("ipc://")).unlink(missing_ok=True)


def kept_stop_path(endpoint: str) -> Path:
    """Return the file that keeps an emergency stop for the device with an ipc endpoint until it is armed."""
    return Path(estop_endpoint(endpoint).removeprefix("ipc://") + _KEPT_SUFFIX)


class Peer(NamedTuple):
    """The process and the user that hold a socket, from the kernel; 0 and None if the kernel does not tell."""

    process: int
    user: int | None

    @property
    def is_trusted(self) -> bool:
        """Whether the socket belongs to this user or root; true if unknown, as only they can write to its folder."""
        return self.user is None or self.user in (os.geteuid(), 0)


def bound_by(endpoint: str) -> Peer | None:
    """Return the process that holds an ipc endpoint; None if there is none, as a socket left behind does not answer."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.setblocking(False)
        try:
            probe.connect(endpoint.removeprefix("ipc://"))
            process, user, _ = struct.unpack("3i", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
        except BlockingIOError:
            # Another process has the socket, and its queue of connections is full.
            return Peer(0, None)
        except OSError:
            return None
        except AttributeError:
            # This system has no SO_PEERCRED.
            return Peer(0, None)
    return Peer(process, user)


def is_bound(endpoint: str) -> bool:
    """Return whether a process holds an ipc endpoint: a socket that a killed process left behind does not answer."""
    return bound_by(endpoint) is not None


def folder_identity(folder: Path) -> Path:
    """Return a canonical path, equal for all spellings of a folder, whether or not the folder exists."""
    # Folders of a process in a container are behind a link in /proc that `resolve` would follow in this process's view.
    return folder if folder.parts[:2] == ("/", "proc") else folder.resolve()

"""Where the sockets of a rig are on this machine. It imports nothing: an emergency stop has no time for models."""

import os
from pathlib import Path

RUNTIME_DIRECTORY_VARIABLE = "TELENANO_RUNTIME_DIR"
_RUNTIME_PLACEHOLDER = "{runtime}"
_ESTOP_SUFFIX = ".estop"
_KEPT_SUFFIX = ".kept"


def runtime_directory() -> Path:
    """Return the private folder of ipc sockets: TELENANO_RUNTIME_DIR, or one of this user's own."""
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


def is_in_runtime_directory(text: str) -> bool:
    """Return whether an ipc endpoint of a site file is in the private folder."""
    return _RUNTIME_PLACEHOLDER in text


def estop_endpoint(endpoint: str) -> str:
    """Return where the node with an ipc endpoint takes emergency stops, from any number of senders."""
    return endpoint + _ESTOP_SUFFIX


def kept_stop_path(endpoint: str) -> Path:
    """Return the file that keeps an emergency stop for the device with an ipc endpoint until it is armed."""
    return Path(estop_endpoint(endpoint).removeprefix("ipc://") + _KEPT_SUFFIX)

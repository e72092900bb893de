"""Objects that may stand at a path instead of a file, and odd names of paths, for tests of code that opens files."""

import os
import socket
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

# A file of this size has no blocks on the disk [bytes].
_HUGE = 1 << 36


def _socket(path: Path) -> None:
    before = Path.cwd()
    # The address of a socket may be shorter than the path, so use a relative one.
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as bound:
            bound.bind(path.name)
    finally:
        os.chdir(before)


def _device(path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can make a device")
    # The device of /dev/zero, which has no end.
    os.mknod(path, 0o600 | stat.S_IFCHR, os.makedev(1, 5))


def _huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(_HUGE)


PLACES: dict[str, Callable[[Path], Any]] = {
    "pipe": os.mkfifo,
    "socket": _socket,
    "folder": Path.mkdir,
    "link to what has no end": lambda path: path.symlink_to("/dev/zero"),
    "link to nothing": lambda path: path.symlink_to("/nonexistent/file"),
    "link to itself": lambda path: path.symlink_to(path.name),
    "device": _device,
    "file too large": _huge,
}
# Names below the folder in which a test runs.
NAMES = {
    "empty": "",
    "line break": "a\nb` c",
    "half of a character": "a\udcff",
    "turns the direction and clears the screen": "a\u202eb\x1b[2J",
    "too long": "n" * 300,
    "below a file": "file/deep/x",
    "with a dash in front": "-x y",
}

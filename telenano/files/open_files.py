"""Which process has a file open."""

import contextlib
import os
from pathlib import Path


def holder_of(path: str, processes: Path = Path("/proc")) -> str:
    """Return the process that has a device file open as `name (pid)`; empty if none is found or may be seen.

    holder_of("/dev/ttyACM0")    # 'minicom (4711)'

    Args:
        path: The file.
        processes: The folder of the processes of this machine.
    """
    wanted = os.path.realpath(path)
    for folder in processes.iterdir():
        if not folder.name.isdecimal() or int(folder.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):
            if any(os.path.realpath(entry) == wanted for entry in (folder / "fd").iterdir()):
                return f"{(folder / 'comm').read_text().strip()} ({folder.name})"
    return ""

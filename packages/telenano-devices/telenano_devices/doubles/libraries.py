"""Libraries for tests with the symbols of Force Dimension's DHD and OpenHaptics' HD, compiled where there is a cc."""

import ctypes
import os
import shutil
from pathlib import Path
from typing import Any

from telenano_devices.handle.firmware import compiled as compile_library

FOLDER = Path(__file__).parent
# Scenarios of these tests name the doubles, and the processes of their rigs inherit that they may.
os.environ["TELENANO_ALLOW_CODE"] = "1"
# What `pytest.mark.skipif` is given for a test of them.
WITHOUT_CC: dict[str, Any] = {
    "condition": shutil.which("cc") is None,
    "reason": "the doubles of vendors' libraries need a C compiler: apt install gcc libc6-dev",
}


def build(name: str) -> Path:
    """Return the double of `dhd` or `hd`, compiled unless that was done before."""
    source, header = FOLDER / f"{name}.c", FOLDER / "arm.h"
    flags = ["-std=gnu99", "-O2", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared", str(source), "-lm", "-pthread"]
    return compile_library(f"double-{name}", [source, header], flags, "the double of a vendor's library needs")


class Double:
    """What a test does to a double that is loaded in this process, beside the driver."""

    def __init__(self, path: Path) -> None:
        self._lib = ctypes.CDLL(str(path))
        self._lib.telenano_double_set.argtypes = [ctypes.c_char_p, ctypes.c_double]
        self._lib.telenano_double_get.argtypes = [ctypes.c_char_p]
        self._lib.telenano_double_get.restype = ctypes.c_double
        self._lib.telenano_double_hand.argtypes = [ctypes.c_char_p]
        self._lib.telenano_double_fail.argtypes = [ctypes.c_char_p, ctypes.c_int]

    def set(self, name: str, value: float) -> None:
        self._lib.telenano_double_set(name.encode(), value)

    def get(self, name: str) -> float:
        return float(self._lib.telenano_double_get(name.encode()))

    def fail(self, call: str, error: int) -> None:
        """Let a call fail with an error of the vendor, or, with 0, no longer."""
        self._lib.telenano_double_fail(call.encode(), error)

    def hand(self, path: Path) -> None:
        """Let the hand of a file, as `live_devices.write_hand` writes it, be at the device."""
        self._lib.telenano_double_hand(str(path).encode())

    def tick(self) -> None:
        """Let the scheduler of HD call once."""
        self._lib.telenano_double_tick()

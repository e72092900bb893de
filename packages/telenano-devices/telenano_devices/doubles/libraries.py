"""Libraries for tests with the symbols of Force Dimension's DHD and OpenHaptics' HD, compiled where there is a cc."""

import ctypes
import os
import shutil
from pathlib import Path
from typing import Any

from telenano_devices.handle.firmware import compiled as compile_library

FOLDER = Path(__file__).parent
# Scenarios of these tests load the doubles, which the processes of their rigs may do by this inherited variable.
os.environ["TELENANO_ALLOW_CODE"] = "1"
# Keyword arguments of `pytest.mark.skipif` for tests of the doubles.
WITHOUT_CC: dict[str, Any] = {
    "condition": shutil.which("cc") is None,
    "reason": "the doubles of vendors' libraries need a C compiler: apt install gcc libc6-dev",
}


def build(name: str) -> Path:
    """Return the double of `dhd` or `hd`, compiled unless that is done already."""
    source, header = FOLDER / f"{name}.c", FOLDER / "arm.h"
    flags = ["-std=gnu99", "-O2", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared", str(source), "-lm", "-pthread"]
    return compile_library(f"double-{name}", [source, header], flags, "the double of a vendor's library needs")


class Double:
    """Controls a double that is loaded in this process beside the driver, for a test."""

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
        """Make a call fail with an error code of the vendor; 0 ends that."""
        self._lib.telenano_double_fail(call.encode(), error)

    def hand(self, path: Path) -> None:
        """Put the hand of a file, as `live_devices.write_hand` writes it, at the device."""
        self._lib.telenano_double_hand(str(path).encode())

    def tick(self) -> None:
        """Make the scheduler of HD call back once."""
        self._lib.telenano_double_tick()

"""How a vendor's library that the user installs is found and loaded; no part of one is in this tree."""

import ctypes
import ctypes.util
import os
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from telenano.extend.impedance import DeviceError
from telenano.settings import refused_code


class VendorLibrary(NamedTuple):
    """A library: what it is for, the names of its files, the folders of its own, and where to get it.

    setting: the key of a scenario that names the file outright. install: a sentence for a person.
    """

    what: str
    names: tuple[str, ...]
    folders: tuple[str, ...]
    setting: str
    install: str


_FD_FOLDERS = (f"$FDSDK/lib/release/lin-{platform.machine()}-gcc", "~/.local/lib", "/usr/local/lib", "/usr/lib")
DHD = VendorLibrary(
    "Force Dimension SDK (libdhd)",
    # DRD has all of DHD; the versions are those of the SDK.
    ("libdrd.so.3", "libdhd.so.3", "libdrd.so", "libdhd.so", "drd64.dll", "dhd64.dll", "libdhd.dylib"),
    _FD_FOLDERS,
    "haptic_node.dhd.library",
    "get the SDK at forcedimension.com (Software), unpack it, and set FDSDK to its folder; it needs libusb-1.0",
)
HD = VendorLibrary(
    "OpenHaptics (libHD) of the Touch",
    ("libHD.so", "libHD.so.3.4", "libHD.so.3.0", "HD.dll"),
    ("/usr/lib", "/usr/lib64", "/usr/local/lib"),
    "haptic_node.hd.library",
    "get OpenHaptics and the Touch device driver at support.3dsystems.com; the driver's setup pairs the device first",
)
# What a library for tests has besides: it is told of the session, so that its hand begins.
_DOUBLE = "telenano_double_session"


def find(library: VendorLibrary) -> str:
    """Return the file of a library, or its name where the loader of the system finds it; empty if it is not there."""
    folders = [Path(os.path.expandvars(folder)).expanduser() for folder in library.folders]
    for name in library.names:
        for folder in folders:
            if "$" not in str(folder) and (folder / name).is_file():
                return str(folder / name)
    for name in library.names:
        stem = name.removeprefix("lib").split(".")[0]
        found = ctypes.util.find_library(stem)
        if found:
            return found
    return ""


def load(library: VendorLibrary, path: str | None) -> ctypes.CDLL:
    """Load a library, from a path that the settings give and the user allows, or where it is found.

    Raises:
        DeviceError: It is not there, or it cannot be loaded; the message says where to get it.
    """
    if path and (text := refused_code(library.setting, path)):
        raise DeviceError(text)
    found = path or find(library)
    if not found:
        raise DeviceError(f"{library.what} is not installed: {library.install}, or name it as {library.setting}")
    try:
        return ctypes.CDLL(found)
    except OSError as error:
        raise DeviceError(f"{library.what}: {found} cannot be loaded ({error}): {library.install}") from error


def declare(loaded: ctypes.CDLL, what: str, calls: Mapping[str, tuple[type | None, Sequence[type]]]) -> None:
    """Give each call its result and its arguments.

    Raises:
        DeviceError: A call is missing: it is another library, or too old.
    """
    for name, (result, arguments) in calls.items():
        try:
            call = getattr(loaded, name)
        except AttributeError as error:
            raise DeviceError(f"{what}: the library has no {name}: another one, or too old") from error
        call.restype, call.argtypes = result, list(arguments)


def is_double(loaded: ctypes.CDLL) -> bool:
    """Return whether this is a library for tests, with an emulated device."""
    return hasattr(loaded, _DOUBLE)


def tell_session(loaded: ctypes.CDLL, runs: bool) -> None:
    """Tell a library for tests whether the session runs; a vendor's is told nothing."""
    if is_double(loaded):
        getattr(loaded, _DOUBLE)(ctypes.c_int(runs))

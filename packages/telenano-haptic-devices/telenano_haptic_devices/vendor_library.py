"""How a vendor's library that the user installs is found and loaded; no part of one is in this tree."""

import ctypes
import ctypes.util
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from telenano.extend.hands import Capabilities, DeviceError
from telenano.settings import refused_code


class VendorLibrary(NamedTuple):
    """A library: what it is for, the names of its files, the folders of its own, and where to get it.

    setting: the key of a scenario that names the file outright. install: a sentence for a person. calls: the result and
    the arguments of each function.
    """

    what: str
    names: tuple[str, ...]
    folders: tuple[str, ...]
    setting: str
    install: str
    calls: Mapping[str, tuple[type | None, Sequence[type]]]


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
        library_path = ctypes.util.find_library(stem)
        if library_path:
            return library_path
    return ""


def load(library: VendorLibrary, path: str | None) -> ctypes.CDLL:
    """Load a library, from a path that the settings give and the user allows, or where it is found.

    Raises:
        DeviceError: It is not there, or it cannot be loaded; the message says where to get it.
    """
    if path and (text := refused_code(library.setting, path)):
        raise DeviceError(text)
    name = path or find(library)
    if not name:
        raise DeviceError(f"{library.what} is not installed: {library.install}, or name it as {library.setting}")
    try:
        return ctypes.CDLL(name)
    except OSError as error:
        raise DeviceError(f"{library.what}: {name} cannot be loaded ({error}): {library.install}") from error


def _declare(loaded: ctypes.CDLL, library: VendorLibrary) -> None:
    """Give each call its result and its arguments; DeviceError where one is missing."""
    for name, (result, arguments) in library.calls.items():
        try:
            call = getattr(loaded, name)
        except AttributeError as error:
            raise DeviceError(
                f"{library.what}: the library has no {name}: it is another library, or too old"
            ) from error
        call.restype, call.argtypes = result, list(arguments)


def is_double(loaded: ctypes.CDLL) -> bool:
    """Return whether this is a library for tests, with an emulated device."""
    return hasattr(loaded, _DOUBLE)


class LibraryWire:
    """An `ImpedanceWire` to a device behind a vendor's library, which is loaded once; a subclass has `run` and `close`.

    Args:
        settings: Those of the driver, with a key `library`.
        now_ns: The monotonic clock [ns], which a test replaces.
        sleep: Waits for a time [s].
    """

    library: ClassVar[VendorLibrary]

    def __init__(
        self,
        settings: Any,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._settings, self._now_ns, self._sleep = settings, now_ns, sleep
        self._lib: Any = None

    def open(self) -> Capabilities:
        """Load the library and find the device; DeviceError says what is missing, and the device is closed."""
        if self._lib is None:
            loaded = load(self.library, self._settings.library)
            _declare(loaded, self.library)
            self._lib = loaded
        try:
            return self._come_up()
        except DeviceError:
            self.close()
            raise

    def session(self, runs: bool) -> None:
        """Tell a library for tests whether the session runs; a vendor's is sent nothing."""
        if self._lib is not None and is_double(self._lib):
            getattr(self._lib, _DOUBLE)(ctypes.c_int(runs))

    def close(self) -> None:
        """Take the force away and let the device go; harmless when already closed."""
        raise NotImplementedError

    def _come_up(self) -> Capabilities:
        """Find the device with no force, and return what it declares; DeviceError says what is missing."""
        raise NotImplementedError

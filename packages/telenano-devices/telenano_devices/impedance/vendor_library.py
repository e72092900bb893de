"""Finds, loads and calls a vendor's library that the user has installed; this tree contains no part of any."""

import ctypes
import ctypes.util
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple

from telenano.extend.hands import Capabilities, DeviceError
from telenano.settings import refused_code
from telenano_devices.impedance.coupling import UPRIGHT, ZERO, Vector
from telenano_devices.impedance.impedance_wire import Turn
from telenano_devices.impedance.wires import Cadence, Declared, Frame, Mechanics, declared


class VendorLibrary(NamedTuple):
    """A library: its name and purpose, the names of its files, its usual folders, and where to get it.

    setting: key of a scenario that names the file itself. install: advice for a person. calls: C declarations of the
    functions without the names of arguments, such as `int dhdOpenSerial(int)`. types: types in `calls` that are not
    those of C, by name.
    """

    what: str
    names: tuple[str, ...]
    folders: tuple[str, ...]
    setting: str
    install: str
    calls: str
    types: Mapping[str, Any] = MappingProxyType({})

    def prototypes(self) -> Iterator[tuple[str, Any, list[Any]]]:
        """Yield name, result type and argument types of each function."""
        for result, name, arguments in re.findall(r"([\w*]+) (\w+)\(([^)]*)\)", self.calls):
            yield name, self._type(result), [self._type(each.strip()) for each in arguments.split(",") if each.strip()]

    def _type(self, name: str) -> Any:
        types = {**_TYPES, **self.types}
        return types[name] if name in types else ctypes.POINTER(types[name.removesuffix("*")])


_TYPES: dict[str, Any] = {
    **{name: getattr(ctypes, f"c_{name}") for name in ("double", "int", "uint", "ulong", "ushort")},
    **{
        "char": ctypes.c_byte,
        "uchar": ctypes.c_ubyte,
        "char*": ctypes.c_char_p,
        "void*": ctypes.c_void_p,
        "void": None,
    },
}
# An additional function of libraries for tests, which tells them whether the session runs, for their hand.
_DOUBLE = "telenano_double_session"


def find(library: VendorLibrary) -> str:
    """Return the file of a library, or its name if the system's loader finds it; empty if it is not installed."""
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
    """Load a library, from a path in the settings that the user allows, or from where `find` finds it.

    Raises:
        DeviceError: The path is not allowed, or the library is not installed or cannot be loaded.
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
    """Declare the result and argument types of each function; raise DeviceError if the library lacks one."""
    for name, result, arguments in library.prototypes():
        try:
            call = getattr(loaded, name)
        except AttributeError as error:
            raise DeviceError(
                f"{library.what}: the library has no {name}: it is another library, or too old"
            ) from error
        call.restype, call.argtypes = result, arguments


def is_double(loaded: ctypes.CDLL) -> bool:
    """Return whether this is a library for tests, with an emulated device."""
    return hasattr(loaded, _DOUBLE)


def text_of(value: bytes | None, otherwise: str = "") -> str:
    """Return a text from a library, or `otherwise` if it is empty."""
    return (value or otherwise.encode()).decode(errors="replace")


class LibraryWire:
    """An `ImpedanceWire` to a device behind a vendor's library, which is loaded once.

    A subclass finds the device, reads it, writes a force, and reports faults. `run` does so at absolute deadlines; for
    a library with its own scheduler, that scheduler calls `answered` instead.

    Args:
        settings: The settings of the driver, with the keys `library`, `rate_hz` and `deadman_button`.
        now_ns: The monotonic clock [ns]; a test replaces it.
        sleep: The function that waits for a time [s].
    """

    library: ClassVar[VendorLibrary]
    frame: ClassVar[Frame]
    # Mechanics of the emulated arm in the library for tests.
    arm: ClassVar[Mechanics]
    # Period of the calls of `trouble` [ns]; 0 means at each sample.
    status_every_ns: ClassVar[int] = 0
    # The device in words; `declared` replaces it by the identity.
    name: str

    def __init__(
        self,
        settings: Any,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._settings, self._now_ns, self._sleep = settings, now_ns, sleep
        self._lib: Any = None
        self._status_ns, self._error = 0, ""

    def open(self) -> Capabilities:
        """Load the library, find the device and return its capabilities.

        Raises:
            DeviceError: Library or device is missing or unfit; the device is then closed.
        """
        if self._lib is None:
            loaded = load(self.library, self._settings.library)
            _declare(loaded, self.library)
            self._lib = loaded
        self._status_ns = 0
        try:
            return self.come_up()
        except DeviceError:
            self.close()
            raise

    def run(self, turn: Turn) -> None:
        """Answer samples at absolute deadlines; a call that takes longer than a period determines the rate."""
        cadence = Cadence(self._settings.rate_hz, self._now_ns, self._sleep)
        while self.answered(turn):
            cadence.wait()

    def answered(self, turn: Turn) -> bool:
        """Read the device, call `turn`, and write the force that it returns; return whether to continue."""
        if self._lib is None:
            raise DeviceError(f"{self.name} is not open")
        taken_ns = self._now_ns()
        place, buttons, rows = self.read()
        if taken_ns >= self._status_ns:
            self._status_ns, self._error = taken_ns + self.status_every_ns, self.trouble()
        sample = self.frame.sample(
            place,
            taken_ns,
            buttons=buttons,
            deadman=self._settings.deadman_button,
            orientation=UPRIGHT if rows is None else self.frame.orientation(rows),
            error=self._error,
        )
        force = turn(sample)
        self.write(self.frame.to_device(ZERO if force is None else force))
        return force is not None

    def session(self, runs: bool) -> None:
        """Tell a library for tests whether the session runs; do nothing for a vendor's library."""
        if self._lib is not None and is_double(self._lib):
            getattr(self._lib, _DOUBLE)(ctypes.c_int(runs))

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function of the library and return its result; raise DeviceError if it failed."""
        result = getattr(self._lib, name)(*arguments)
        self.check(name, result)
        return result

    def check(self, call: str, result: Any = None) -> None:
        """Raise DeviceError if a call has failed."""
        if reason := self.reason(result):
            raise DeviceError(f"{self.name}: {call} failed: {reason}")

    def declared(self, identity: str, make: Declared, buttons: tuple[str, ...], has_orientation: bool) -> Capabilities:
        """Return the capabilities of the device, and take `name` from their identity."""
        number = self._settings.deadman_button
        able = declared(
            identity,
            make,
            self._settings.rate_hz,
            arm=self.arm if is_double(self._lib) else None,
            buttons=buttons,
            deadman="" if number is None else (*buttons, *map(str, range(len(buttons), number + 1)))[number],
            has_orientation=has_orientation,
        )
        self.name = able.identity
        return able

    def close(self) -> None:
        """Remove the force and release the device; harmless when already closed."""
        raise NotImplementedError

    def come_up(self) -> Capabilities:
        """Open the device without force, and return its capabilities; raise DeviceError if it is missing."""
        raise NotImplementedError

    def read(self) -> tuple[Sequence[float], int, Sequence[Sequence[float]] | None]:
        """Return position [m], buttons as bits and rows of the handle's rotation or None, in the device's frame."""
        raise NotImplementedError

    def write(self, force: Vector) -> None:
        """Set a force [N] in the frame of the device."""
        raise NotImplementedError

    def trouble(self) -> str:
        """Return why the device must not be driven now, empty if it may; raise DeviceError if it is gone."""
        raise NotImplementedError

    def reason(self, result: Any) -> str:
        """Return why the call with this result failed; empty if it succeeded."""
        raise NotImplementedError

"""How a vendor's library that the user installs is found, loaded and called; no part of one is in this tree."""

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
    """A library: what it is for, the names of its files, the folders of its own, and where to get it.

    setting: the key of a scenario that names the file outright. install: a sentence for a person. calls: the functions
    as C declares them, without the names of arguments, such as `int dhdOpenSerial(int)`. types: those of `calls` that
    are not of C, by name.
    """

    what: str
    names: tuple[str, ...]
    folders: tuple[str, ...]
    setting: str
    install: str
    calls: str
    types: Mapping[str, Any] = MappingProxyType({})

    def prototypes(self) -> Iterator[tuple[str, Any, list[Any]]]:
        """Yield name, type of the result and types of the arguments of each function."""
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
    """Return a text of a library."""
    return (value or otherwise.encode()).decode(errors="replace")


class LibraryWire:
    """An `ImpedanceWire` to a device behind a vendor's library, which is loaded once.

    A subclass finds the device, reads it, writes a force, and says what is wrong with it. `run` does so at an absolute
    cadence, and a scheduler of the library calls `answered`.

    Args:
        settings: Those of the driver, with the keys `library`, `rate_hz` and `deadman_button`.
        now_ns: The monotonic clock [ns], which a test replaces.
        sleep: Waits for a time [s].
    """

    library: ClassVar[VendorLibrary]
    frame: ClassVar[Frame]
    # the arm of the library for tests
    arm: ClassVar[Mechanics]
    # How often the device is asked what is wrong with it [ns]; 0 is at each sample.
    status_every_ns: ClassVar[int] = 0
    # the device in words, before it is known
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
        """Load the library and find the device; DeviceError says what is missing, and the device is closed."""
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
        """Answer at an absolute cadence; a call that takes longer than a period sets the rate itself."""
        cadence = Cadence(self._settings.rate_hz, self._now_ns, self._sleep)
        while self.answered(turn):
            cadence.wait()

    def answered(self, turn: Turn) -> bool:
        """Read the device and write the force that answers; return whether there is to be another sample."""
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
        """Tell a library for tests whether the session runs; a vendor's is sent nothing."""
        if self._lib is not None and is_double(self._lib):
            getattr(self._lib, _DOUBLE)(ctypes.c_int(runs))

    def call(self, name: str, *arguments: Any) -> Any:
        """Call a function of the library and return its result; DeviceError where it failed."""
        result = getattr(self._lib, name)(*arguments)
        self.check(name, result)
        return result

    def check(self, call: str, result: Any = None) -> None:
        """Raise DeviceError where a call has failed."""
        if reason := self.reason(result):
            raise DeviceError(f"{self.name}: {call} failed: {reason}")

    def declared(self, identity: str, make: Declared, buttons: tuple[str, ...], has_orientation: bool) -> Capabilities:
        """Return what the device declares, by which it is named after that."""
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
        """Take the force away and let the device go; harmless when already closed."""
        raise NotImplementedError

    def come_up(self) -> Capabilities:
        """Find the device with no force, and return what it declares; DeviceError says what is missing."""
        raise NotImplementedError

    def read(self) -> tuple[Sequence[float], int, Sequence[Sequence[float]] | None]:
        """Return place [m], buttons as bits and the rows of the handle's rotation, None without one, in its frame."""
        raise NotImplementedError

    def write(self, force: Vector) -> None:
        """Set a force [N] in the frame of the device."""
        raise NotImplementedError

    def trouble(self) -> str:
        """Return why the device must not be driven now; empty if it may. DeviceError where it is gone."""
        raise NotImplementedError

    def reason(self, result: Any) -> str:
        """Return why the call with that result has failed; empty if it has not."""
        raise NotImplementedError

"""Compiles the core of the handle's firmware for this machine, where an emulated handle and the tests run it."""

import ctypes
import hashlib
import os
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from telenano.files import is_own
from telenano.signals import run as run_child
from telenano.wire import TelenanoError

SOURCES = Path(__file__).parent / "handle"
_FILES = ("core/frame.c", "core/handle.c", "boards/posix/posix.c")
_HEADERS = ("core/frame.h", "core/handle.h")
_FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-fPIC", "-shared")
_ROOM = 8192


class FirmwareError(TelenanoError):
    """The firmware cannot be compiled or run here; the text says what is missing."""


class BoardIdentity(NamedTuple):
    """The identity of a board, as it reports it in HELLO."""

    device_id: int
    session: int
    flags: int
    reset_cause: int
    m_per_count: float
    n_per_count: float
    drive_n_per_count: float
    model: str


class BoardSample(NamedTuple):
    """The measurements of a board in a millisecond, in counts; `flags`: those of STATE that only the board knows."""

    time_us: int
    position: int
    force: int
    sensed_drive: int
    supply_10mv: int
    flags: int


def build_library(sources: Path = SOURCES, folder: Path | None = None) -> Path:
    """Return the firmware as a shared library, compiled if necessary; raise FirmwareError if that fails."""
    parts = [sources / name for name in (*_FILES, *_HEADERS)]
    files = [str(sources / name) for name in _FILES]
    return compiled("handle", parts, [*_FLAGS, *files], "an emulated handle runs the firmware, which needs", folder)


def compiled(
    name: str,
    parts: Sequence[Path],
    arguments: Sequence[str],
    purpose: str,
    folder: Path | None = None,
    extra: str = "",
) -> Path:
    """Return a shared library in the user's cache, compiled unless it was compiled before from the same sources.

    Args:
        name: The name of the library.
        parts: All source files of the library.
        arguments: The arguments of the compiler.
        purpose: The beginning of the message if there is no compiler.
        folder: The folder of the library; None for the user's cache.
        extra: Further packages that the compilation needs.

    Raises:
        FirmwareError: A source or the compiler is missing, or the compiler fails.
    """
    try:
        digest = hashlib.sha256(b"".join(part.read_bytes() for part in parts)).hexdigest()[:16]
    except OSError as error:
        raise FirmwareError(f"{error.filename}: the source of the firmware is missing: {error.strerror}") from error
    cache = folder or Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "telenano"
    library = cache / f"{name}-{digest}.so"
    # A file that others can write or replace is not loaded, and the code is compiled again.
    if library.exists() and is_own(library):
        return library
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        raise FirmwareError(f"{purpose} a C compiler: apt install gcc libc6-dev{extra}")
    cache.mkdir(parents=True, exist_ok=True)
    # The complete library is renamed into place, because another process may compile the same one now.
    with tempfile.TemporaryDirectory(dir=cache) as work:
        made = Path(work) / library.name
        done = run_child([compiler, *arguments, "-o", str(made)], capture_output=True, text=True, check=False)
        if done.returncode:
            needs = f" (apt install{extra})" if extra else ""
            raise FirmwareError(f"{name} does not compile with {compiler}{needs}: {done.stderr.strip()}")
        made.chmod(0o700)
        made.replace(library)
    return library


class FirmwareCore:
    """The firmware of one handle: bytes and samples in, drive and bytes out. Its time is that of the samples."""

    def __init__(self, identity: BoardIdentity) -> None:
        self._functions = _functions(build_library())
        self._handle = self._functions.emulated_new(
            identity.device_id,
            identity.session,
            identity.flags,
            identity.reset_cause,
            identity.m_per_count,
            identity.n_per_count,
            identity.drive_n_per_count,
            identity.model.encode(),
        )
        self._buffer = ctypes.create_string_buffer(_ROOM)

    def __del__(self) -> None:
        if getattr(self, "_handle", None):
            self._functions.emulated_free(self._handle)
            self._handle = None

    def receive(self, received: bytes) -> None:
        self._functions.emulated_receive(self._handle, received, len(received))

    def tick(self, sample: BoardSample) -> int:
        """Take the sample of a millisecond; return the drive until the next one [counts]."""
        return int(self._functions.emulated_tick(self._handle, sample.time_us & 0xFFFFFFFF, *sample[1:]))

    def sent(self) -> bytes:
        """Return the bytes that the handle has sent since the last call."""
        length = self._functions.emulated_sent(self._handle, self._buffer, _ROOM)
        return self._buffer.raw[:length]

    def encode(self, payload: bytes) -> bytes:
        """Return a payload as the firmware encodes it for the line."""
        length = self._functions.emulated_encode(payload, len(payload), self._buffer)
        return self._buffer.raw[:length]

    @property
    def mode(self) -> int:
        return int(self._functions.emulated_mode(self._handle))

    @property
    def tripped(self) -> bool:
        """Whether the watchdog has switched the drive off."""
        return bool(self._functions.emulated_tripped(self._handle))

    @property
    def session_runs(self) -> bool:
        """Whether the newest command says that the session runs."""
        return bool(self._functions.emulated_session_runs(self._handle))

    @property
    def receive_errors(self) -> int:
        """Number of frames that were bad or not obeyed."""
        return int(self._functions.emulated_errors(self._handle))


def _functions(library: Path) -> Any:
    loaded = ctypes.CDLL(str(library))
    u8, u16, u32, u64, i32 = ctypes.c_uint8, ctypes.c_uint16, ctypes.c_uint32, ctypes.c_uint64, ctypes.c_int32
    pointer, text, real = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_float
    table: dict[str, tuple[Any, tuple[Any, ...]]] = {
        "emulated_new": (pointer, (u64, u16, u8, u8, real, real, real, text)),
        "emulated_free": (None, (pointer,)),
        "emulated_receive": (None, (pointer, text, u32)),
        "emulated_tick": (i32, (pointer, u32, i32, i32, i32, ctypes.c_int16, u8)),
        "emulated_sent": (u32, (pointer, text, u32)),
        "emulated_mode": (u8, (pointer,)),
        "emulated_tripped": (u8, (pointer,)),
        "emulated_session_runs": (u8, (pointer,)),
        "emulated_errors": (u16, (pointer,)),
        "emulated_encode": (u32, (text, u8, text)),
    }
    for name, (result, arguments) in table.items():
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, arguments
    return loaded

"""A serial port that never waits: pyserial opens, configures and closes it; `os.read` and `os.write` move the bytes.

pyserial's own `write` with a full buffer either waits for ever or fails after everything was sent, and its `read`
selects and reads at least twice: neither is fit for a loop of 1 kHz.
"""

import contextlib
import errno
import fcntl
import os
import termios
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from telenano.extend.hands import DeviceError
from telenano.wire.extras import how_to_install

# The most bytes of one read; a device sends far fewer in 50 ms at 1 Mbaud.
_READ_BYTES = 8192
_NOTHING = (errno.EAGAIN, errno.EWOULDBLOCK, errno.EINTR)
# termios.error is not an OSError; pyserial's SerialException is one.
PORT_ERRORS = (OSError, termios.error, ValueError)


class Port(Protocol):
    """A line of bytes to a device. Each method but `close` raises DeviceError when the line is gone."""

    def read(self) -> bytes:
        """Return the bytes that have come since the last call, without waiting."""

    def write(self, frame: bytes) -> bool:
        """Send a whole frame; return False if the line takes no more now and the frame is dropped."""

    def close(self) -> None:
        """Release the line; harmless when it is gone."""


OpenPort = Callable[[str, int], Port]


class SerialPort:
    """A serial port, opened for this process alone."""

    def __init__(self, path: str, baud: int) -> None:
        """Open a port.

        Raises:
            DeviceError: The port cannot be opened; the message gives the reason, or the process that holds it.
        """
        try:
            import serial
        except ImportError as error:
            raise DeviceError(f"haptic_node.driver: serial needs pyserial: {how_to_install('haptic')}") from error
        self.path = path
        self._cut = False
        try:
            self._serial: Any = serial.Serial(path, baud, timeout=0, exclusive=True)
        except PORT_ERRORS as error:
            raise DeviceError(_refusal(path, error)) from error
        try:
            self._descriptor: int = self._serial.fileno()
            self._prepare()
        except PORT_ERRORS as error:
            self.close()
            raise DeviceError(f"{path}: cannot be prepared: {error}") from error

    def _prepare(self) -> None:
        # This keeps out programs that ignore the lock, such as ModemManager.
        with contextlib.suppress(OSError):
            fcntl.ioctl(self._descriptor, termios.TIOCEXCL)
        # A board must not reset when the port is closed.
        attributes = termios.tcgetattr(self._descriptor)
        attributes[2] &= ~termios.HUPCL
        termios.tcsetattr(self._descriptor, termios.TCSANOW, attributes)
        # Without this flag FTDI drivers hold bytes back for 16 ms; other drivers do not have it.
        with contextlib.suppress(OSError, ValueError, AttributeError):
            self._serial.set_low_latency_mode(True)
        self._serial.reset_input_buffer()

    def read(self) -> bytes:
        """Return the bytes that have come since the last call, without waiting."""
        try:
            data = os.read(self._descriptor, _READ_BYTES)
        except OSError as error:
            if error.errno in _NOTHING:
                return b""
            raise DeviceError(f"{self.path}: the device is gone: {error.strerror}") from error
        # An unplugged line reads as ended.
        if not data and not Path(self.path).exists():
            raise DeviceError(f"{self.path}: the device is gone")
        return data

    def write(self, frame: bytes) -> bool:
        """Send a whole frame; return False if the line takes no more now and the frame is dropped."""
        # A zero ends a frame of which the line took only a part last time.
        wanted = b"\0" + frame if self._cut else frame
        try:
            sent = os.write(self._descriptor, wanted)
        except OSError as error:
            if error.errno in _NOTHING:
                return False
            raise DeviceError(f"{self.path}: the device is gone: {error.strerror}") from error
        self._cut = sent < len(wanted)
        return not self._cut

    def close(self) -> None:
        """Release the port at once: while it is held, the kernel gives a returning device another name."""
        # If another process has the port open too, this mark would outlive us and keep every program out.
        with contextlib.suppress(*PORT_ERRORS):
            fcntl.ioctl(self._serial.fileno(), termios.TIOCNXCL)
        with contextlib.suppress(*PORT_ERRORS):
            self._serial.close()


def holder_of(path: str, processes: Path = Path("/proc")) -> str:
    """Return the process that has a device file open, as `name (pid)`; empty if none is found or visible."""
    wanted = os.path.realpath(path)
    for folder in processes.iterdir():
        if not folder.name.isdecimal() or int(folder.name) == os.getpid():
            continue
        with contextlib.suppress(OSError):
            if any(os.path.realpath(entry) == wanted for entry in (folder / "fd").iterdir()):
                return f"{(folder / 'comm').read_text().strip()} ({folder.name})"
    return ""


def _refusal(path: str, error: BaseException) -> str:
    number = getattr(error, "errno", None)
    if not Path(path).exists():
        return f"{path}: there is no such port; `telenano device list` shows those that there are"
    if number == errno.EACCES:
        return (
            f"{path}: no permission; `sudo usermod -aG dialout $USER` and log in again, or install the udev rule of "
            "packages/telenano-devices/docs/devices.md"
        )
    if number in (errno.EAGAIN, errno.EBUSY, errno.EWOULDBLOCK):
        holder = holder_of(path)
        return f"{path}: is in use" + (f" by {holder}: end it first" if holder else ": end the program that uses it")
    return f"{path}: cannot be opened as a serial port: {error}"

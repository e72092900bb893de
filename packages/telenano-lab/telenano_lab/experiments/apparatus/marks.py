"""Trigger marks for devices that record beside the rig, such as an EEG amplifier: a byte at both ends of a trial.

A byte is the number of the trial's condition, PRACTICE or END, as a pulse: PULSE_S later the byte 0 follows. A serial
port receives the bytes, as trigger boxes expect; a parallel port (`/dev/parport0` of Linux) has the byte on its eight
data lines; a file or a pipe receives the bytes, for tests.
"""

import fcntl
import os
import stat
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from telenano.wire import ConfigError, RigError
from telenano_lab.experiments.plan import Plan
from telenano_lab.experiments.types import Trial

# Byte of a practice trial.
PRACTICE = 254
# Byte of the end of a trial.
END = 255
# Duration of a pulse [s].
PULSE_S = 0.01
# Major device number of Linux's parallel ports.
_PARALLEL = 99
# Requests to a parallel port: exclusive access, claim, and write the data lines.
_EXCLUSIVE = 0x708F
_CLAIM = 0x708B
_DATA = 0x40017086

Write = Callable[[int], object]


def code_of(plan: Plan, trial: Trial) -> int:
    """Return the byte of a trial: PRACTICE, or the number of its condition, from 1 in the order of the file."""
    return PRACTICE if trial.phase == "practice" else plan.number(trial)


class Marks:
    """A port to which marks are written.

    Args:
        port: Its path.
        baud: The rate of a serial port [1/s].

    Raises:
        ConfigError: It cannot be opened; the message says why.
    """

    def __init__(self, port: Path, baud: int) -> None:
        self._port = port
        try:
            self._write, self.close = _opened(port, baud)
        except (OSError, ValueError) as error:
            raise ConfigError(f"--marks {port}: cannot be opened: {_reason(error)}") from error

    def send(self, code: int) -> int:
        """Write a byte, and 0 after PULSE_S; return the time of writing since the epoch [ns].

        Raises:
            RigError: It could not be written; the message says where and why.
        """
        try:
            self._write(code)
            now_ns = time.time_ns()
            time.sleep(PULSE_S)
            self._write(0)
        except OSError as error:
            raise RigError(f"the mark {code} was not written to {self._port}: {_reason(error)}") from error
        return now_ns


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


def _opened(port: Path, baud: int) -> tuple[Write, Callable[[], None]]:
    """Return two functions: one that writes a byte to a port without blocking, and one that closes it."""
    descriptor = os.open(port, os.O_WRONLY | os.O_APPEND | os.O_NONBLOCK | os.O_NOCTTY)
    status, close = os.fstat(descriptor), partial(os.close, descriptor)
    if os.isatty(descriptor):
        close()
        return _serial(port, baud)
    if stat.S_ISREG(status.st_mode) and status.st_size:
        close()
        raise ValueError("it is a file with a content, to which bytes would be appended: name a port or an empty file")
    if stat.S_ISCHR(status.st_mode) and os.major(status.st_rdev) == _PARALLEL:
        try:
            fcntl.ioctl(descriptor, _EXCLUSIVE)
            fcntl.ioctl(descriptor, _CLAIM)
        except OSError:
            close()
            raise
        return lambda code: fcntl.ioctl(descriptor, _DATA, bytes([code])), close
    return lambda code: os.write(descriptor, bytes([code])), close


def _serial(port: Path, baud: int) -> tuple[Write, Callable[[], None]]:
    try:
        import serial
    except ImportError as error:
        raise ConfigError(f"--marks {port}: a serial port needs pyserial: pip install pyserial") from error
    line = serial.Serial(str(port), baud, timeout=0, write_timeout=0.1, exclusive=True)
    return lambda code: line.write(bytes([code])), line.close

"""Runs the emulated handle in real time on a pseudo-terminal, which looks like a serial port with a board."""

import contextlib
import fcntl
import os
import select
import termios
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from telenano_devices.handle.emulated_handle import TICK_US

_TICK_NS = TICK_US * 1000
_READ_BYTES = 4096
# After a longer stall the emulation continues from the present, because a board does not catch up with lost time.
_LONGEST_NS = 50 * _TICK_NS
# Silence after which the host counts as gone, since it sends a thousand commands a second.
_ABANDONED_NS = 200 * _TICK_NS


class EmulatedBoard(Protocol):
    """A board in virtual time, advanced by milliseconds."""

    def receive(self, received: bytes) -> None: ...

    def sent(self) -> bytes:
        """Return the bytes that the board has sent since the last call."""

    def advance(self) -> None:
        """Advance by a millisecond."""

    def reset(self, session: int) -> None:
        """Boot again; a board that counts its sessions itself ignores `session`."""


class HandleOnPty:
    """A handle whose port is `link`, a symbolic link like those of /dev/serial/by-id.

    Raises:
        OSError: The link cannot be made.
    """

    def __init__(self, handle: EmulatedBoard, link: Path) -> None:
        self._handle, self._link = handle, link
        self._master = self._slave = -1
        self._next_ns = self._received_ns = time.monotonic_ns()
        self.plug_in()

    @property
    def plugged(self) -> bool:
        return self._master >= 0

    def plug_in(self) -> None:
        """Plug the cable in; harmless when it is in."""
        if self.plugged:
            return
        # The slave end stays open here too, or the port would end with its first reader.
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        with contextlib.suppress(FileNotFoundError):
            self._link.unlink()
        self._link.parent.mkdir(parents=True, exist_ok=True)
        self._link.symlink_to(os.ttyname(self._slave))

    def pull_out(self) -> None:
        """Pull the cable out: the port is gone, the board runs on; harmless when it is out."""
        if not self.plugged:
            return
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1
        with contextlib.suppress(FileNotFoundError):
            self._link.unlink()

    def run(self, continues: Callable[[], bool]) -> None:
        """Run in real time while `continues`, called once a millisecond, returns True."""
        self._next_ns = time.monotonic_ns()
        while continues():
            self._next_ns += _TICK_NS
            while (left_ns := self._next_ns - time.monotonic_ns()) > 0:
                self._listen(left_ns * 1e-9)
            if time.monotonic_ns() - self._next_ns > _LONGEST_NS:
                self._next_ns = time.monotonic_ns()
            self._handle.advance()
            self._send()
            self._release_abandoned()

    def _release_abandoned(self) -> None:
        """Clear the exclusive mark of a host that was killed; a real port would be free, but here the slave is open."""
        if self.plugged and self._next_ns - self._received_ns > _ABANDONED_NS:
            self._received_ns = self._next_ns
            fcntl.ioctl(self._slave, termios.TIOCNXCL)

    def _listen(self, wait_s: float) -> None:
        """Wait up to wait_s [s] for bytes, pass them to the handle, and send its answer."""
        if not self.plugged:
            time.sleep(wait_s)
            return
        ready, _, _ = select.select([self._master], [], [], wait_s)
        if ready:
            self._received_ns = time.monotonic_ns()
            with contextlib.suppress(BlockingIOError):
                self._handle.receive(os.read(self._master, _READ_BYTES))
            self._send()

    def _send(self) -> None:
        sent = self._handle.sent()
        if sent and self.plugged:
            # Without a reader the bytes are lost, as on a line without a listener.
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, sent)

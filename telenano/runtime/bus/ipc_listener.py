"""The socket file of an ipc endpoint that this process has bound, identified by its inode.

The inode is kept open, because the system could otherwise reuse its number for a new file as soon as this one was
removed.

libzmq removes any file at the path of an endpoint when it binds and when it closes, even one of another process. It
leaves a socket alone that it was passed as a descriptor, so this module makes the listening socket, and removes its
file only if the file is still this process's own.
"""

import contextlib
import errno
import os
import socket as sockets
from pathlib import Path
from typing import Any

import zmq

from telenano.runtime.bus.local_endpoint import LONGEST_IPC_PATH
from telenano.runtime.bus.pin import Pin
from telenano.wire.errors import EndpointError

# Options that may have been set for connections from other machines after the ipc endpoint was bound; they must not
# apply to readers on this machine. libzmq cannot reset the domain of authentication: the authenticator accepts
# processes of this user without keys.
_PLAIN = (zmq.CURVE_SERVER, zmq.AFFINITY, zmq.HEARTBEAT_IVL, zmq.HANDSHAKE_IVL)
# Connections that the system queues until this process accepts them; the default of libzmq.
_BACKLOG = 100


class IpcListener:
    """Binds a ZeroMQ socket to an ipc endpoint, and binds it again when its file is gone."""

    def __init__(self, socket: "zmq.Socket[bytes]", endpoint: str) -> None:
        """Bind the endpoint; raise OSError or ZMQError if that fails."""
        self.path = Path(endpoint.removeprefix("ipc://"))
        self._socket, self._endpoint = socket, endpoint
        self._options = {option: socket.get(option) for option in _PLAIN}
        self._pin: Pin | None = None
        self._bind()

    def lost(self) -> str:
        """Return the path if its file was removed or replaced; empty while the file is in place."""
        is_kept = self._socket.closed or self._pin is None or self._pin.is_in_place()
        return "" if is_kept else str(self.path)

    def make_again(self) -> None:
        """Bind the path once more; existing connections stay, because the first listener is not closed.

        Raises:
            EndpointError: The path cannot be bound.
        """
        changed: dict[zmq.SocketOption, Any] = {
            option: now for option, plain in self._options.items() if (now := self._socket.get(option)) != plain
        }
        for option in changed:
            self._socket.set(option, self._options[option])
        try:
            self._bind()
        except (OSError, zmq.ZMQError) as error:
            raise EndpointError(f"{self._endpoint}: cannot be bound again: {error.strerror or error}") from error
        finally:
            for option, value in changed.items():
                self._socket.set(option, value)

    def remove(self) -> None:
        """Remove the file if it is still that of this process."""
        if self._pin is not None:
            self._pin.remove()
            self._pin = None

    def _bind(self) -> None:
        if len(os.fsencode(self.path)) > LONGEST_IPC_PATH:
            raise OSError(errno.ENAMETOOLONG, f"the path is longer than {LONGEST_IPC_PATH} bytes")
        with sockets.socket(sockets.AF_UNIX, sockets.SOCK_STREAM) as listening:
            listening.setblocking(False)
            with contextlib.suppress(FileNotFoundError):
                # This process has the lock of the endpoint, so no other process uses a file that was left here.
                self.path.unlink()
            listening.bind(str(self.path))
            pin = Pin(self.path)
            listening.listen(_BACKLOG)
            self._socket.set(zmq.USE_FD, listening.fileno())
            try:
                self._socket.bind(self._endpoint)
            except zmq.ZMQError:
                pin.remove()
                raise
            finally:
                self._socket.set(zmq.USE_FD, -1)
            # libzmq owns the descriptor from here on and closes it.
            listening.detach()
        if self._pin is not None:
            self._pin.close()
        self._pin = pin

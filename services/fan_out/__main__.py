"""One reader of each node in the place of many: observers connect here, and a node sends each message once.

It imports no model, because a rig starts it with each session. A subscription of an observer is passed on to the node,
so what is not read is not sent here either.

libzmq gives a connection up for good where its peer breaks the protocol, so that a node might be heard by everybody but
the observers. What is handed on of a node is therefore listened to here as well: where its beacon does not come by that
way, and comes by a new connection to the node, the node is served anew, with all sockets of its own.
"""

import contextlib
import errno
import os
import select
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

import zmq

from telenano.runtime.bus.ipc_listener import IpcListener
from telenano.runtime.bus.local_endpoint import fan_out_endpoint, is_bound

# as many as a publisher keeps for a reader that stands still
_HIGH_WATER_MARK = 22_000
# A lost node is connected to again after this time, which grows to _RECONNECT_MOST_MS.
_RECONNECT_MS = 100
_RECONNECT_MOST_MS = 1000
# A display may be late, touch may not.
_NICENESS = 5
# The sockets are looked at this often [s].
_LOOK_S = 0.25
# Every node sends this twice a second.
_BEACON = b"node/health"
# A node of which nothing was handed on at this number of looks in a row is listened to by a further connection.
_SILENT_LOOKS = 4
# It is closed after this number of looks without anything, as it may itself have been given up.
_LISTENS_LOOKS = 5
# A node that was served anew and is still not heard is served anew again after so many looks at the earliest.
_PAUSE_LOOKS = 20
# This is enough to know that something comes; what the socket does not hold is dropped.
_PROBED = 20


def serve(context: "zmq.Context[zmq.Socket[bytes]]", endpoint: str) -> IpcListener:
    """Hand on what the node with an endpoint publishes, in a thread that runs no Python; it ends with the context.

    Returns:
        The socket file at which observers connect.
    """
    node, observers = context.socket(zmq.XSUB), context.socket(zmq.XPUB)
    node.set(zmq.RCVHWM, _HIGH_WATER_MARK)
    observers.set(zmq.SNDHWM, _HIGH_WATER_MARK)
    node.set(zmq.RECONNECT_IVL, _RECONNECT_MS)
    node.set(zmq.RECONNECT_IVL_MAX, _RECONNECT_MOST_MS)
    for each in (node, observers):
        each.set(zmq.LINGER, 0)
    try:
        listener = IpcListener(observers, fan_out_endpoint(endpoint))
    except (OSError, zmq.ZMQError):
        node.close()
        observers.close()
        raise
    node.connect(endpoint)
    threading.Thread(target=_hand_on, args=(node, observers), name="fan_out", daemon=True).start()
    return listener


def _hand_on(node: "zmq.Socket[bytes]", observers: "zmq.Socket[bytes]") -> None:
    with node, observers:
        try:
            zmq.proxy(node, observers)
        except zmq.ContextTerminated:
            return
        except zmq.ZMQError as error:
            # The context that ends closes them, perhaps before the thread is told of it.
            if error.errno != errno.ENOTSOCK:
                raise


class ServedNode:
    """One node as it is served: the sockets of its own, and what is heard of it."""

    def __init__(self, context: "zmq.Context[zmq.Socket[bytes]]", endpoint: str) -> None:
        """Serve a node; OSError or ZMQError where the socket cannot be bound.

        Args:
            context: That of the sockets by which the node is listened to.
            endpoint: The local endpoint of the node.
        """
        self._listening, self._endpoint = context, endpoint
        self._own: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._silent_looks = self._wait = self._listens = 0
        self._probe: zmq.Socket[bytes] | None = None
        try:
            self.listener = serve(self._own, endpoint)
        except (OSError, zmq.ZMQError):
            self._own.term()
            raise
        self._behind = self._listen(fan_out_endpoint(endpoint))

    def look(self) -> None:
        """Serve the node anew where its socket is gone, or where it sends and nothing is handed on."""
        # The folder is made again by the nodes, which look at whose it is.
        is_gone = self.listener.lost() and _is_private(self.listener.path.parent)
        if is_gone or self._is_deaf():
            with contextlib.suppress(OSError, zmq.ZMQError):
                self._serve_anew()

    def close(self) -> None:
        """Leave no socket behind."""
        self.listener.remove()
        self._close_probe()
        self._behind.close(0)
        self._own.term()

    def _serve_anew(self) -> None:
        own: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        try:
            listener = serve(own, self._endpoint)
        except (OSError, zmq.ZMQError):
            own.term()
            raise
        # Those who are connected by the old sockets come to the new ones as these are closed.
        self._own.term()
        self._own, self.listener = own, listener
        self._behind.close(0)
        self._behind = self._listen(fan_out_endpoint(self._endpoint))
        self._silent_looks = 0

    def _is_deaf(self) -> bool:
        """Return whether the node sends, which a further connection shows, and nothing of it is handed on."""
        self._wait = max(0, self._wait - 1)
        if _drained(self._behind):
            self._silent_looks = 0
            self._close_probe()
            return False
        self._silent_looks += 1
        if self._silent_looks < _SILENT_LOOKS or self._wait:
            return False
        if self._probe is None:
            # To connect where nobody listens would not tell anything.
            self._probe = self._listen(self._endpoint) if is_bound(self._endpoint) else None
            self._listens = 0
            return False
        if _drained(self._probe):
            self._close_probe()
            self._wait = _PAUSE_LOOKS
            return True
        self._listens += 1
        if self._listens >= _LISTENS_LOOKS:
            self._close_probe()
        return False

    def _listen(self, endpoint: str) -> "zmq.Socket[bytes]":
        socket = self._listening.socket(zmq.SUB)
        socket.set(zmq.RCVHWM, _PROBED)
        socket.subscribe(_BEACON)
        socket.connect(endpoint)
        return socket

    def _close_probe(self) -> None:
        if self._probe is not None:
            self._probe.close(0)
            self._probe = None


def _drained(socket: "zmq.Socket[bytes]") -> bool:
    """Return whether something has come, which is thrown away."""
    came = False
    with contextlib.suppress(zmq.Again):
        while True:
            socket.recv_multipart(zmq.DONTWAIT)
            came = True
    return came


def main(endpoints: Sequence[str]) -> None:
    """Serve the nodes of a rig until its launcher closes the standard input, or ends, and leave no socket behind."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)
    with zmq.Context() as context:
        nodes = [ServedNode(context, endpoint) for endpoint in endpoints]
        while not select.select([sys.stdin], [], [], _LOOK_S)[0]:
            for node in nodes:
                node.look()
        for node in nodes:
            node.close()


def _is_private(folder: Path) -> bool:
    try:
        status = folder.stat()
    except OSError:
        return False
    return status.st_uid == os.geteuid() and not status.st_mode & 0o077


if __name__ == "__main__":
    main(sys.argv[1:])

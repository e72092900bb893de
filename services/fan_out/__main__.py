"""The fan-out of a rig: observers connect to this process, so that a node sends each message only once.

It imports no models, because a rig starts it with each session. Subscriptions of observers are forwarded to the node,
so the node does not send topics that nobody reads.

libzmq permanently gives up a connection whose peer breaks the protocol, so the fan-out could lose a node that all other
readers still hear. Therefore this process also listens to its own output: if the beacon of a node is missing there, but
comes through a new connection to the node, all sockets for that node are replaced.
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

# Messages kept for a reader that stands still, as many as a publisher keeps.
_HIGH_WATER_MARK = 22_000
# First interval between attempts to reconnect to a lost node; it grows to _RECONNECT_MOST_MS.
_RECONNECT_MS = 100
_RECONNECT_MOST_MS = 1000
# Displays may be late, but the haptic loop may not, so this process has low priority.
_NICENESS = 5
# Interval between checks of the sockets [s].
_LOOK_S = 0.25
# Topic that every node publishes twice a second.
_BEACON = b"node/health"
# Number of successive checks without output from a node after which it is probed by a new connection.
_SILENT_LOOKS = 4
# Number of checks without a message after which the probe is closed, because libzmq may have given it up too.
_LISTENS_LOOKS = 5
# Least number of checks between two replacements of the sockets of a node.
_PAUSE_LOOKS = 20
# Messages that a listening socket holds, enough to see that some come; the others are dropped.
_PROBED = 20


def serve(context: "zmq.Context[zmq.Socket[bytes]]", endpoint: str) -> IpcListener:
    """Forward the messages of the node at an endpoint, in a thread that runs no Python and ends with the context.

    Returns:
        The listener at whose socket file observers connect.

    Raises:
        OSError, zmq.ZMQError: The socket cannot be bound.
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
            # An ending context closes the sockets, perhaps before the thread gets ContextTerminated.
            if error.errno != errno.ENOTSOCK:
                raise


class ServedNode:
    """The sockets that serve one node, and the checks that its messages are forwarded."""

    def __init__(self, context: "zmq.Context[zmq.Socket[bytes]]", endpoint: str) -> None:
        """Start to serve a node; raise OSError or ZMQError if the socket cannot be bound.

        Args:
            context: The context of the sockets that check the node and the output.
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
        """Replace the sockets if the socket file is gone, or if the node sends but nothing is forwarded."""
        # Nodes create the folder again, and check its owner; without a private folder nothing can be bound.
        is_gone = self.listener.lost() and _is_private(self.listener.path.parent)
        if is_gone or self._is_deaf():
            with contextlib.suppress(OSError, zmq.ZMQError):
                self._serve_anew()

    def close(self) -> None:
        """Remove the socket file and close all sockets."""
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
        # Observers on the old sockets reconnect to the new ones when the old ones close.
        self._own.term()
        self._own, self.listener = own, listener
        self._behind.close(0)
        self._behind = self._listen(fan_out_endpoint(self._endpoint))
        self._silent_looks = 0

    def _is_deaf(self) -> bool:
        """Return whether nothing is forwarded although the node sends, as a probe by a new connection shows."""
        self._wait = max(0, self._wait - 1)
        if _drained(self._behind):
            self._silent_looks = 0
            self._close_probe()
            return False
        self._silent_looks += 1
        if self._silent_looks < _SILENT_LOOKS or self._wait:
            return False
        if self._probe is None:
            # A connection to an unbound endpoint would show nothing.
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
    """Discard all waiting messages; return whether there were any."""
    came = False
    with contextlib.suppress(zmq.Again):
        while True:
            socket.recv_multipart(zmq.DONTWAIT)
            came = True
    return came


def main(endpoints: Sequence[str]) -> None:
    """Serve the nodes of a rig until its launcher closes the standard input or ends; then remove all sockets."""
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

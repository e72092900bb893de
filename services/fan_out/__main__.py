"""The fan-out of a rig: observers connect to this process, so that a node sends each message only once.

It imports no models, because a rig starts it with each session. Subscriptions of observers are forwarded to the node,
so the node does not send topics that nobody reads.

libzmq permanently gives up a connection whose peer breaks the protocol, so the fan-out could lose a node that all other
readers still hear. Then the sockets for that node are replaced, by the rule for connections within a machine
(`telenano/runtime/bus/socket_monitor.py`).
"""

import contextlib
import errno
import os
import select
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import zmq

from telenano.runtime.bus.ipc_listener import IpcListener
from telenano.runtime.bus.local_endpoint import fan_out_endpoint
from telenano.runtime.bus.socket_monitor import LOCAL_ENDS, Connection, Monitor

# Messages kept for this process if it stands still, as many as a publisher keeps, and for an observer that does: those
# of a second, because an observer may lack some, and may be any program.
_HIGH_WATER_MARK, _OF_AN_OBSERVER = 22_000, 2_200
# Interval between attempts to reconnect to a lost node.
_RECONNECT_MS = 100
# Displays may be late, but the haptic loop may not, so this process has low priority.
_NICENESS = 5
# Interval between checks of the sockets [s].
_LOOK_S = 0.25
# Number of looks after which the connection to a node that is there, and that libzmq has not begun again, is given up.
_LOOKS = 3


def serve(
    context: "zmq.Context[zmq.Socket[bytes]]",
    endpoint: str,
    watch: "Callable[[zmq.Socket[bytes]], None]" = lambda node: None,
) -> IpcListener:
    """Forward the messages of the node at an endpoint, in a thread that runs no Python and ends with the context.

    Args:
        context: The context of the sockets.
        endpoint: The local endpoint of the node.
        watch: Called with the socket that reads the node, before it connects.

    Returns:
        The listener at whose socket file observers connect.

    Raises:
        OSError, zmq.ZMQError: The socket cannot be bound.
    """
    node, observers = context.socket(zmq.XSUB), context.socket(zmq.XPUB)
    node.set(zmq.RCVHWM, _HIGH_WATER_MARK)
    observers.set(zmq.SNDHWM, _OF_AN_OBSERVER)
    node.set(zmq.RECONNECT_IVL, _RECONNECT_MS)
    for each in (node, observers):
        each.set(zmq.LINGER, 0)
    try:
        listener = IpcListener(observers, fan_out_endpoint(endpoint))
    except (OSError, zmq.ZMQError):
        node.close()
        observers.close()
        raise
    watch(node)
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

    def __init__(self, endpoint: str) -> None:
        """Start to serve the node at a local endpoint; raise OSError or ZMQError if the socket cannot be bound."""
        self._endpoint = endpoint
        self._open()

    def look(self) -> None:
        """Replace the sockets if the socket file is gone, or if libzmq has given up the connection to the node."""
        for event in self._monitor.events():
            self._connection.record(event.kind)
        self._connection.look()
        # Nodes create the folder again, and check its owner; without a private folder nothing can be bound.
        is_gone = self.listener.lost() and _is_private(self.listener.path.parent)
        if is_gone or self._connection.is_given_up(_LOOKS):
            before = self._context, self.listener, self._monitor
            self._open()
            # Observers on the old sockets reconnect to the new ones when the old ones close.
            _close(*before)

    def close(self) -> None:
        """Remove the socket file and close all sockets."""
        _close(self._context, self.listener, self._monitor)

    def _open(self) -> None:
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        try:
            self.listener = serve(context, self._endpoint, self._watch)
        except (OSError, zmq.ZMQError):
            context.term()
            raise
        self._context = context

    def _watch(self, node: "zmq.Socket[bytes]") -> None:
        self._monitor, self._connection = Monitor(node, LOCAL_ENDS), Connection(self._endpoint)


def _close(context: "zmq.Context[zmq.Socket[bytes]]", listener: IpcListener, monitor: Monitor) -> None:
    listener.remove()
    monitor.close()
    context.term()


def main(endpoints: Sequence[str]) -> None:
    """Serve the nodes of a rig until its launcher closes the standard input or ends; then remove all sockets."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)
    nodes = [ServedNode(endpoint) for endpoint in endpoints]
    while not select.select([sys.stdin], [], [], _LOOK_S)[0]:
        for node in nodes:
            # Without a descriptor or memory, the next look tries again.
            with contextlib.suppress(OSError, zmq.ZMQError):
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

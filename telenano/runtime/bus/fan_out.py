"""One reader of each node in the place of many: observers connect here, and a node sends each message once.

It imports no model, because a rig starts it with each session. A subscription of an observer is passed on to the node,
so what is not read is not sent here either.
"""

import contextlib
import os
import select
import sys
import threading
from collections.abc import Sequence
from pathlib import Path

import zmq

from telenano.runtime.bus.ipc_listener import IpcListener
from telenano.runtime.bus.local_endpoint import fan_out_endpoint

# as many as a publisher keeps for a reader that stands still
_HIGH_WATER_MARK = 22_000
# A lost node is connected to again after this time, which grows to _RECONNECT_MOST_MS.
_RECONNECT_MS = 100
_RECONNECT_MOST_MS = 1000
# A display may be late, touch may not.
_NICENESS = 5
# The sockets are looked at this often [s].
_LOOK_S = 0.5


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
    with node, observers, contextlib.suppress(zmq.ContextTerminated):
        zmq.proxy(node, observers)


def main(endpoints: Sequence[str]) -> None:
    """Serve the nodes of a rig until its launcher closes the standard input, or ends, and leave no socket behind.

    Where the sockets were removed, new ones are served. Those who are connected by the old ones remain so.
    """
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)
    with zmq.Context() as context:
        listeners = {endpoint: serve(context, endpoint) for endpoint in endpoints}
        while not select.select([sys.stdin], [], [], _LOOK_S)[0]:
            for endpoint, listener in listeners.items():
                # The folder is made again by the nodes, which look at whose it is.
                if listener.lost() and _is_private(listener.path.parent):
                    with contextlib.suppress(OSError, zmq.ZMQError):
                        listeners[endpoint] = serve(context, endpoint)
    for listener in listeners.values():
        listener.remove()


def _is_private(folder: Path) -> bool:
    try:
        status = folder.stat()
    except OSError:
        return False
    return status.st_uid == os.geteuid() and not status.st_mode & 0o077


if __name__ == "__main__":
    main(sys.argv[1:])

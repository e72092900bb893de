"""One reader of each node in the place of many: observers connect here, and a node sends each message once.

It imports no model, because a rig starts it with each session. A subscription of an observer is passed on to the node,
so what is not read is not sent here either.
"""

import contextlib
import os
import sys
import threading
from collections.abc import Sequence

import zmq

from telenano.runtime.bus.local_endpoint import fan_out_endpoint, remove_fan_out

# as many as a publisher keeps for a reader that stands still
_HIGH_WATER_MARK = 22_000
# A lost node is connected to again after this time, which grows to _RECONNECT_MOST_MS.
_RECONNECT_MS = 100
_RECONNECT_MOST_MS = 1000
# A display may be late, touch may not.
_NICENESS = 5


def serve(context: "zmq.Context[zmq.Socket[bytes]]", endpoint: str) -> threading.Thread:
    """Hand on what the node with an endpoint publishes, in a thread that runs no Python; it ends with the context."""
    node, observers = context.socket(zmq.XSUB), context.socket(zmq.XPUB)
    node.set(zmq.RCVHWM, _HIGH_WATER_MARK)
    observers.set(zmq.SNDHWM, _HIGH_WATER_MARK)
    node.set(zmq.RECONNECT_IVL, _RECONNECT_MS)
    node.set(zmq.RECONNECT_IVL_MAX, _RECONNECT_MOST_MS)
    for each in (node, observers):
        each.set(zmq.LINGER, 0)
    observers.bind(fan_out_endpoint(endpoint))
    node.connect(endpoint)
    thread = threading.Thread(target=_hand_on, args=(node, observers), name="fan_out", daemon=True)
    thread.start()
    return thread


def _hand_on(node: "zmq.Socket[bytes]", observers: "zmq.Socket[bytes]") -> None:
    with node, observers, contextlib.suppress(zmq.ContextTerminated):
        zmq.proxy(node, observers)


def main(endpoints: Sequence[str]) -> None:
    """Serve the nodes of a rig until its launcher closes the standard input, or ends, and leave no socket behind."""
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, _NICENESS)
    with zmq.Context() as context:
        for endpoint in endpoints:
            serve(context, endpoint)
        sys.stdin.read()
    remove_fan_out(endpoints)


if __name__ == "__main__":
    main(sys.argv[1:])

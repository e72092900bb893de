"""libzmq's socket monitor events, and the count of rejected connections."""

from typing import NamedTuple

import zmq

CONNECTED = int(zmq.EVENT_HANDSHAKE_SUCCEEDED)
CLOSED_IN_HANDSHAKE = int(zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL)
PROTOCOL_FAILED = int(zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL)
KEY_REFUSED = int(zmq.EVENT_HANDSHAKE_FAILED_AUTH)
DISCONNECTED = int(zmq.EVENT_DISCONNECTED)
FAILURES = {
    CLOSED_IN_HANDSHAKE: "the connection was closed during the handshake, or the handshake timed out",
    PROTOCOL_FAILED: "the peer used another protocol, no encryption, or another key",
    KEY_REFUSED: "the key was rejected",
}
# Most events read in a turn of the node's loop.
_BATCH = 8


class MonitorEvent(NamedTuple):
    """An event of a connection; the value is that of libzmq, for some kinds a file descriptor."""

    kind: int
    value: int
    endpoint: str


class Monitor:
    """The events of one socket that concern handshakes and lost connections."""

    def __init__(self, socket: "zmq.Socket[bytes]", wanted: int) -> None:
        """Monitor a socket for the events in the bit mask `wanted`."""
        self.has_pending = False
        self.socket: zmq.Socket[bytes] = socket.get_monitor_socket(wanted)
        # Imported here, because it loads asyncio and ssl, and a rig on one machine monitors no sockets.
        from zmq.utils.monitor import recv_monitor_message

        self._receive = recv_monitor_message

    def events(self) -> list[MonitorEvent]:
        """Return a bounded number of pending events; set `has_pending` if there may be more."""
        taken: list[MonitorEvent] = []
        for _ in range(_BATCH):
            try:
                event = self._receive(self.socket, zmq.NOBLOCK)
            except zmq.Again:
                self.has_pending = False
                return taken
            endpoint = event["endpoint"].decode(errors="replace")
            taken.append(MonitorEvent(int(event["event"]), int(event["value"]), endpoint))
        self.has_pending = True
        return taken


class RejectionCounter:
    """Counts rejected connections by reason, and keeps the newest rejection in words."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.last_error = ""

    def record(self, reason: str, text: str) -> None:
        self.counts[reason] = self.counts.get(reason, 0) + 1
        self.last_error = text

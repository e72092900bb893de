"""What libzmq says of connections, and the account of those that were refused."""

import zmq
from zmq.utils.monitor import recv_monitor_message

CONNECTED = int(zmq.EVENT_HANDSHAKE_SUCCEEDED)
CLOSED_IN_HANDSHAKE = int(zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL)
PROTOCOL_FAILED = int(zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL)
KEY_REFUSED = int(zmq.EVENT_HANDSHAKE_FAILED_AUTH)
DISCONNECTED = int(zmq.EVENT_DISCONNECTED)
FAILURES = {
    CLOSED_IN_HANDSHAKE: "the connection was closed in the handshake, or it took too long",
    PROTOCOL_FAILED: "another protocol was spoken, no encryption, or with another key",
    KEY_REFUSED: "the key was refused",
}
# events taken in a turn of the node's loop
_AT_ONCE = 8


class Monitor:
    """The events of one socket that concern handshakes and lost connections."""

    def __init__(self, socket: "zmq.Socket[bytes]", wanted: int) -> None:
        """Watch a socket for the events that are added up in `wanted`."""
        self.has_pending = False
        self.socket: zmq.Socket[bytes] = socket.get_monitor_socket(wanted)

    def events(self) -> list[tuple[int, str]]:
        """Give event and endpoint of what has happened; `has_pending` afterwards when there may be more."""
        found: list[tuple[int, str]] = []
        for _ in range(_AT_ONCE):
            try:
                event = recv_monitor_message(self.socket, zmq.NOBLOCK)
            except zmq.Again:
                self.has_pending = False
                return found
            found.append((int(event["event"]), event["endpoint"].decode(errors="replace")))
        self.has_pending = True
        return found


class RejectionCounter:
    """How often connections were refused, by reason, and the newest of them in words."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.newest = ""

    def enter(self, reason: str, text: str) -> None:
        """Count a refusal."""
        self.counts[reason] = self.counts.get(reason, 0) + 1
        self.newest = text

"""What libzmq reports of the connections of a socket, and which of them it has given up.

libzmq makes a lost connection again by itself. It does not if the peer broke the protocol, such as by a frame that is
too large: then it gives the endpoint up for good, and both processes go on in silence. It reports the end of each
connection, though, and each beginning. So one rule finds what it has given up within a machine, in a node and in the
fan-out: a connection has ended, and at further looks libzmq has not begun it again.

The module imports no models, because the fan-out starts with each session.
"""

import struct
from dataclasses import dataclass
from typing import NamedTuple

import zmq

from telenano.runtime.bus.local_endpoint import is_bound, path_of

# The peer was reached, and the handshake follows.
REACHED = int(zmq.EVENT_CONNECTED)
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
# The events by which a `Connection` is followed; those of an ipc endpoint also tell each attempt of libzmq.
ENDS = CONNECTED | CLOSED_IN_HANDSHAKE | PROTOCOL_FAILED | KEY_REFUSED | DISCONNECTED
LOCAL_ENDS = ENDS | REACHED
# Most events read in a turn of the node's loop.
_BATCH = 8
# The first frame of an event: its kind, and its value.
_EVENT = struct.Struct("=HI")


class MonitorEvent(NamedTuple):
    """An event of a connection; the value is that of libzmq, for some kinds a file descriptor."""

    kind: int
    value: int
    endpoint: str


class Monitor:
    """The events of one socket that concern its connections."""

    def __init__(self, socket: "zmq.Socket[bytes]", wanted: int) -> None:
        """Monitor a socket for the events in the bit mask `wanted`."""
        self.has_pending = False
        self._monitored = socket
        self.socket: zmq.Socket[bytes] = socket.get_monitor_socket(wanted)

    def events(self) -> list[MonitorEvent]:
        """Return a bounded number of pending events; set `has_pending` if there may be more."""
        taken: list[MonitorEvent] = []
        for _ in range(_BATCH):
            try:
                event, endpoint = self.socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                self.has_pending = False
                return taken
            kind, value = _EVENT.unpack(event)
            taken.append(MonitorEvent(kind, value, endpoint.decode(errors="replace")))
        self.has_pending = True
        return taken

    def close(self) -> None:
        """Close the socket of the events, at any time in the life of the monitored one."""
        end_monitor(self._monitored)
        self.socket.close()


def end_monitor(socket: "zmq.Socket[bytes]") -> None:
    """End the events of a socket, if it has any, before it or the socket of the events is closed.

    libzmq would wait for ever, in the thread that serves all sockets, to report an event that nobody can read. The call
    is possible while another thread uses the socket, because libzmq guards its monitor by a lock.
    """
    if not socket.closed:
        socket.disable_monitor()


@dataclass
class Connection:
    """A connection to one endpoint, as its events describe it.

    `up`: the handshake has succeeded, and no end was reported since. `ended`: an end was reported, and no beginning
    since. `looks` is the number of looks since that end, and `looks_there` that of the last ones in a row at which the
    same file was at the path of an ipc endpoint, which `there` identifies.
    """

    endpoint: str
    up: bool = False
    ended: bool = False
    looks: int = 0
    looks_there: int = 0
    there: tuple[int, int] | None = None

    def record(self, kind: int) -> None:
        """Record an event of the connection."""
        if kind in (CONNECTED, REACHED):
            self.begin()
            self.up = kind == CONNECTED
        else:
            self.up, self.ended = False, True

    def begin(self) -> None:
        """Note that libzmq, or this process, begins the connection."""
        self.ended, self.looks, self.looks_there, self.there = False, 0, 0, None

    def look(self) -> int:
        """Count a look at a connection that has ended; return at how many looks libzmq has not begun it, 0 if it has.

        libzmq tries at least every 100 ms, and two looks are further apart.
        """
        if self.ended:
            before, self.there = self.there, _file_at(self.endpoint)
            self.looks += 1
            self.looks_there = self.looks_there + 1 if self.there == before else 1
        return self.looks

    def is_given_up(self, looks: int) -> bool:
        """Return whether libzmq has not begun it again although a process has held its ipc endpoint for some looks.

        Raises:
            OSError: Whether a process holds the endpoint cannot be found out.
        """
        return self.there is not None and self.looks_there >= looks and is_bound(self.endpoint)


def _file_at(endpoint: str) -> tuple[int, int] | None:
    """Return inode number and change time [ns] of the file of an ipc endpoint; None without one."""
    if not endpoint.startswith("ipc://"):
        return None
    try:
        status = path_of(endpoint).stat()
    except OSError:
        return None
    return status.st_ino, status.st_ctime_ns


class RejectionCounter:
    """Counts rejected connections by reason, and keeps the newest rejection in words."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self.last_error = ""

    def record(self, reason: str, text: str) -> None:
        self.counts[reason] = self.counts.get(reason, 0) + 1
        self.last_error = text

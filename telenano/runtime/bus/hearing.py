"""Checks whether this process receives from the publishers that it reads, and reconnects to one that it does not hear.

There is one rule for the connections within a machine (`socket_monitor.py` has its reason): a connection that has
ended, and that libzmq has not begun again, is made again. Those to other machines have their own
(`telenano/runtime/security/peer_connections.py`). A connection to this machine is made again at the second look; if the
publisher was there all the time, this process was deaf to it, and reports that and its end.

No thread is needed: a look takes microseconds, and a loop makes one with each report of its health. Safety does not
rely on any of this: a device acts on the age of its newest input.
"""

import errno
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import zmq

from telenano.runtime.bus.bus import ConnectionEvent, Subscriber
from telenano.runtime.bus.socket_monitor import LOCAL_ENDS, Connection, Monitor, MonitorEvent
from telenano.timing.clock import Clock
from telenano.wire.messages import MAX_KEYS

# The topic that every node sends twice a second.
BEACON = "node/health"
# Number of looks after which a connection that has ended is made again.
_LOOKS = 2


@dataclass(kw_only=True)
class NodeConnection(Connection):
    """A connection to a node; times on the monotonic clock [ns].

    `since_ns`: time of its last beginning or end. `detached`: the socket has no connection to the endpoint until it is
    made again. `is_deaf`: the publisher was there, and libzmq had given the connection up.
    """

    node: str
    since_ns: int
    detached: bool = False
    is_deaf: bool = False


class LocalConnections:
    """The connections of a subscriber to nodes of its machine, which share its socket."""

    def __init__(self, endpoints: Mapping[str, str], subscriber: Subscriber, clock: Clock) -> None:
        """Connect a subscriber to the ipc endpoints (values) of nodes (keys), and follow the connections."""
        now_ns = clock.monotonic_ns()
        self.subscriber = subscriber
        self.connections = [
            NodeConnection(endpoint, node=node, since_ns=now_ns) for node, endpoint in endpoints.items()
        ]
        self._at = {connection.endpoint: connection for connection in self.connections}
        self.monitor = Monitor(subscriber.socket, LOCAL_ENDS)
        self._clock = clock
        self._events: list[ConnectionEvent] = []
        for endpoint in endpoints.values():
            subscriber.socket.connect(endpoint)

    @property
    def sockets(self) -> list["zmq.Socket[bytes]"]:
        """The sockets for whose events a loop wakes up: none, because connections of this machine wait for a look."""
        return []

    def close(self) -> None:
        """Close the monitor; the owner of the subscriber closes that."""
        self.monitor.close()

    def process_events(self) -> bool:
        """Update the state of the connections from monitor events; return True if more events are pending."""
        for event in self.monitor.events():
            connection = self._at.get(event.endpoint)
            # An event of a connection that this process has let go may come late.
            if connection is not None and not connection.detached:
                self._record(connection, event)
        return self.monitor.has_pending

    def take_events(self) -> list[ConnectionEvent]:
        events, self._events = self._events, []
        return events

    def apply_permissions(self) -> None:
        """Do nothing: connections of this machine need no keys."""

    def look(self, now_ns: int) -> None:
        """Make connections again that libzmq has given up, and report whom this process could not hear."""
        # Disconnecting drops messages that were not read yet, such as the last ones of a node, so all are read before.
        if not self.subscriber.drained:
            return
        due = [connection for connection in self.connections if connection.look() >= _LOOKS]
        deaf = [connection for connection in due if connection.is_given_up(_LOOKS)]
        # All ended connections are let go before any is made again, because libzmq identifies one that it has dropped
        # by an address in memory, which the next connection may reuse.
        for connection in self.connections if due else ():
            if connection.ended:
                self._let_go(connection)
        for connection in deaf:
            self._note_deaf(connection, now_ns)
        for connection in due:
            connection.begin()
            connection.detached = False
            self.subscriber.socket.connect(connection.endpoint)
            # The call may have consumed the signal of the descriptor, for which a loop would wait.
            self.subscriber.drained = False

    def _record(self, connection: NodeConnection, event: MonitorEvent) -> None:
        was_up, now_ns = connection.up, self._clock.monotonic_ns()
        connection.record(event.kind)
        if was_up and not connection.up:
            connection.since_ns = now_ns
        if connection.up and connection.is_deaf:
            connection.is_deaf = False
            silent_s = (now_ns - connection.since_ns) * 1e-9
            text = f"messages of {connection.node} arrive again after {silent_s:.1f} s"
            self._report("info", text, connection, "up", silent_s=silent_s)

    def _note_deaf(self, connection: NodeConnection, now_ns: int) -> None:
        if not connection.is_deaf:
            connection.is_deaf = True
            silent_s = (now_ns - connection.since_ns) * 1e-9
            silence = f"received nothing from {connection.node} for {silent_s:.1f} s, although it runs"
            text = f"{silence}: connected again to {connection.endpoint}"
            self._report("warning", text, connection, "deaf", silent_s=silent_s)

    def _let_go(self, connection: NodeConnection) -> None:
        """Disconnect from an endpoint, unless libzmq has already done so after a violation of the protocol."""
        if connection.detached:
            return
        connection.detached = True
        try:
            self.subscriber.socket.disconnect(connection.endpoint)
        except zmq.ZMQError as error:
            if error.errno != errno.ENOENT:
                raise

    def _report(self, level: str, text: str, connection: NodeConnection, state: str, **data: float) -> None:
        facts: dict[str, bool | float | str] = {"peer": connection.node, "endpoint": connection.endpoint}
        self._events.append(ConnectionEvent(level, text, {**facts, "connection": state, **data}))


class Hearing:
    """All connections of one process to publishers."""

    def __init__(self, clock: Clock) -> None:
        """Begin without connections."""
        self._clock = clock
        self.readers: list[LocalConnections] = []

    def look(self, now_ns: int) -> None:
        """Look after the connections of every reader that is open."""
        for reader in self.readers:
            if not reader.subscriber.socket.closed:
                reader.look(now_ns)

    def deaf(self) -> dict[str, float]:
        """Return the publishers that run but are not heard, each with the time since its connection was lost [s]."""
        now_ns = self._clock.monotonic_ns()
        deaf = [each for each in self._all() if each.is_deaf]
        return {each.node: (now_ns - each.since_ns) * 1e-9 for each in deaf[:MAX_KEYS]}

    def _all(self) -> Iterator[NodeConnection]:
        return (connection for reader in self.readers for connection in reader.connections)

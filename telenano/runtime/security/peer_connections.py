"""The connecting side: connections to nodes of other machines, their state, and the messages permitted on them."""

import errno
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import zmq

from telenano.runtime.bus.address_book import is_relayed, may_carry
from telenano.runtime.bus.bus import ConnectionEvent, Subscriber
from telenano.runtime.bus.socket_monitor import (
    CONNECTED,
    DISCONNECTED,
    ENDS,
    FAILURES,
    KEY_REFUSED,
    Monitor,
    RejectionCounter,
)
from telenano.runtime.security.access_control import AccessControl
from telenano.runtime.security.keyring import Role
from telenano.timing.clock import Clock
from telenano.wire.codec import WireError
from telenano.wire.nodes import is_visitor

# Time until a reconnection [ns]. libzmq does not reconnect after a rejected key or a wrong protocol, and does not
# report that it has given up; but the key may have been allowed meanwhile, or the right program started.
_RECONNECT_NS = 1_000_000_000
_UNREACHED_NS = 5_000_000_000
_REMIND_NS = 60_000_000_000
# A connection that is up and has brought no valid message at this number of checks in a row is replaced. A check is
# made every 0.4 s, and every node sends node/health twice a second. If that does not help, the number doubles up to the
# most. Checks are counted instead of time, because a process that stood still has messages left to read.
_SILENT_CHECKS, _MOST_SILENT_CHECKS = 3, 192
# Number of failed handshakes in a row that is reported; fewer may be chance.
_REPORTED_FAILURES = 3
# Most cached pairs of topic and source that are permitted: a peer that invents names must not fill the memory.
_MAX_PERMITTED = 4096


class MessagePermissions:
    """The messages that one machine may send: topics are limited by its roles, sources by its nodes."""

    def __init__(self, machine: str, nodes: Sequence[str], roles: Sequence[Role]) -> None:
        self.machine = machine
        self._nodes = list(nodes)
        self._roles = frozenset(roles)
        self._permitted: set[tuple[str, str]] = set()

    def change(self, roles: Sequence[Role]) -> None:
        self._roles = frozenset(roles)
        self._permitted.clear()

    def __call__(self, topic: str, src: str) -> None:
        """Raise WireError (`role`, `source`) for a message that this machine may not send."""
        # The cache serves a thousand calls per second for a few pairs.
        if (topic, src) in self._permitted:
            return
        needed: Role = "control" if topic == "session/control" else "data"
        if needed not in self._roles:
            has = ", ".join(sorted(self._roles)) or "none"
            text = f"{topic} of {src}: the machine {self.machine} lacks the role {needed}, it has {has}"
            raise WireError("role", text)
        if not any(may_carry(node, src) for node in self._nodes):
            raise WireError("source", f"{topic}: the machine {self.machine} may not send messages of {src}")
        if len(self._permitted) < _MAX_PERMITTED:
            self._permitted.add((topic, src))


@dataclass
class PeerConnection:
    """The state of a connection to a node of another machine; times on the monotonic clock [ns]."""

    node: str
    endpoint: str
    down_since_ns: int
    next_reminder_ns: int
    up: bool = False
    ever_up: bool = False
    failures: int = 0
    last_error: str = ""
    # Whether the peer is disconnected while libzmq still tries its endpoint.
    lost: bool = False
    # The time of the next reconnection by this module, if any.
    reconnect_ns: int | None = None
    # Number of messages received from the node, and of checks since that last rose; the connection is replaced at
    # `most_silent` of them.
    heard: int = 0
    silent: int = 0
    most_silent: int = _SILENT_CHECKS

    @property
    def is_given_up(self) -> bool:
        """Whether the socket has no connection to the endpoint until the reconnection."""
        return self.reconnect_ns is not None and not self.lost


class PeerConnections:
    """The connections to the nodes of one machine, which share a socket."""

    def __init__(
        self,
        machine: str,
        endpoints: Mapping[str, str],
        subscriber: Subscriber,
        clock: Clock,
        access_control: AccessControl,
        rejections: RejectionCounter,
        *,
        is_reported: bool = True,
        expects_beacon: bool = True,
    ) -> None:
        """Connect a subscriber to the endpoint of each node, if the machine has a valid key.

        Args:
            machine: The other machine.
            endpoints: The endpoints by node.
            subscriber: The subscriber; in a rig with keys it gets the permissions of the machine.
            clock: The clock of the process.
            access_control: The keys and roles.
            rejections: Counts failed handshakes.
            is_reported: Whether changes of the connections are reported as events.
            expects_beacon: Whether the subscriber is subscribed to node/health of every node, so that silence has a
                meaning. Only connections without keys are replaced for it: nothing protects their bytes, so an altered
                subscription, or an altered length of a frame, makes a reader deaf without any report of libzmq. With
                keys the message is not authentic, or its pings are not answered, and libzmq ends the connection.
        """
        self._replaces_silent = expects_beacon and not access_control.requires_keys
        self._is_reported = is_reported
        now = clock.monotonic_ns()
        self.machine = machine
        self.subscriber = subscriber
        self.monitor = Monitor(subscriber.socket, ENDS)
        self.permissions = MessagePermissions(machine, list(endpoints), access_control.roles(machine))
        self._clock = clock
        self._access_control = access_control
        self._rejections = rejections
        self._active = False
        self._server_key: bytes | None = None
        self._events: list[ConnectionEvent] = []
        self.connections = [
            PeerConnection(node, endpoint, now, now + _UNREACHED_NS) for node, endpoint in endpoints.items()
        ]
        if access_control.requires_keys:
            subscriber.permit = self.permissions
        self.apply_permissions()

    @property
    def sockets(self) -> list["zmq.Socket[bytes]"]:
        """The sockets that become readable when there is a monitor event."""
        return [self.monitor.socket]

    def close(self) -> None:
        """Close the monitor; the owner of the subscriber closes that."""
        self.monitor.close()

    def process_events(self) -> bool:
        """Update the state of the connections from monitor events; return True if more events are pending."""
        for event in self.monitor.events():
            peer = self._find(event.endpoint)
            if peer is not None:
                self._record(peer, event.kind)
        return self.monitor.has_pending

    def take_events(self) -> list[ConnectionEvent]:
        events, self._events = self._events, []
        return events

    def apply_permissions(self) -> None:
        """Apply the current roles and key of the machine: connect, or close connections that are no longer allowed."""
        roles, server_key = self._access_control.roles(self.machine), self._access_control.server_key(self.machine)
        self.permissions.change(roles)
        if self._active and (not roles or server_key != self._server_key):
            self._disconnect()
        if roles and not self._active:
            self._connect(server_key)

    def maintain(self, now_ns: int) -> None:
        """Reconnect where libzmq does not, and report peers that have not been reached."""
        # Disconnecting drops messages that were not read yet, such as the last ones of a node, so all are read before.
        if self.subscriber.drained:
            if self._replaces_silent:
                self._give_up_silent(now_ns)
            self._reconnect_due(now_ns)
        for peer in self.connections:
            if not peer.up and not is_visitor(peer.node) and now_ns >= peer.next_reminder_ns:
                peer.next_reminder_ns = now_ns + _REMIND_NS
                self._remind(peer, (now_ns - peer.down_since_ns) * 1e-9)

    def _give_up_silent(self, now_ns: int) -> None:
        """Give up each connection that is up but brings no valid message; it is made again at once."""
        received: Counter[str] = Counter()
        for (_, src), tracker in self.subscriber.trackers.items():
            received[src] += tracker.received + tracker.duplicates
        for peer in self.connections:
            heard = sum(count for src, count in received.items() if may_carry(peer.node, src))
            if heard != peer.heard:
                peer.heard, peer.silent, peer.most_silent = heard, 0, _SILENT_CHECKS
            elif peer.up and not is_visitor(peer.node):
                peer.silent += 1
        silent = [peer for peer in self.connections if peer.up and peer.silent >= peer.most_silent]
        if silent and not self.subscriber.pending():
            # That call may have consumed the signal of the descriptor, for which a loop would wait.
            self.subscriber.drained = False
            for peer in silent:
                self._record_down(peer, "brings no message that can be read: connecting again")
                self._schedule_reconnect(peer)
                peer.reconnect_ns, peer.most_silent = now_ns, min(2 * peer.most_silent, _MOST_SILENT_CHECKS)

    def _reconnect_due(self, now_ns: int) -> None:
        due = [peer for peer in self.connections if peer.reconnect_ns is not None and now_ns >= peer.reconnect_ns]
        # All lost endpoints are disconnected before any is connected, because libzmq identifies a connection that it
        # has dropped by an address in memory, which the next connection may reuse.
        for peer in self.connections if due else ():
            if peer.lost:
                peer.lost = False
                self._let_go(peer.endpoint)
        for peer in due:
            peer.reconnect_ns = None
            self.subscriber.socket.connect(peer.endpoint)

    def _schedule_reconnect(self, peer: PeerConnection) -> None:
        if not peer.is_given_up:
            self._let_go(peer.endpoint)
        peer.lost, peer.reconnect_ns = False, self._clock.monotonic_ns() + _RECONNECT_NS

    def _let_go(self, endpoint: str) -> None:
        """Disconnect from an endpoint, unless libzmq has already done so after a violation of the protocol."""
        try:
            self.subscriber.socket.disconnect(endpoint)
        except zmq.ZMQError as error:
            if error.errno != errno.ENOENT:
                raise

    def _connect(self, server_key: bytes | None) -> None:
        own = self._access_control.own
        if own is not None and server_key is not None:
            self.subscriber.socket.set(zmq.CURVE_PUBLICKEY, own.public)
            self.subscriber.socket.set(zmq.CURVE_SECRETKEY, own.secret)
            self.subscriber.socket.set(zmq.CURVE_SERVERKEY, server_key)
        for peer in self.connections:
            peer.failures, peer.last_error = 0, ""
            self.subscriber.socket.connect(peer.endpoint)
        self._active, self._server_key = True, server_key

    def _disconnect(self) -> None:
        self._active = False
        for peer in self.connections:
            if not peer.is_given_up:
                self._let_go(peer.endpoint)
            peer.lost, peer.reconnect_ns = False, None
            self._record_down(peer, f"was closed: the key of {self.machine} that it used is no longer allowed")

    def _find(self, endpoint: str) -> PeerConnection | None:
        """Return the connection of an endpoint as libzmq reports it, None if there is none.

        libzmq may have resolved a host name to an address. The port then identifies the connection, because all these
        nodes are on one machine with one address.
        """
        exact = [peer for peer in self.connections if peer.endpoint == endpoint]
        port = endpoint.rpartition(":")[2]
        same_port = (peer for peer in self.connections if peer.endpoint.rpartition(":")[2] == port)
        return next(iter(exact or same_port), None)

    def _record(self, peer: PeerConnection, event: int) -> None:
        # An event of a connection that this module has closed may come late.
        if not self._active:
            return
        if event == CONNECTED:
            # A connection that libzmq made by itself may have become ready just before this module gave it up. It is
            # closed, so the reconnection is still due: without it the peer would never be heard again.
            if not peer.is_given_up:
                self._record_up(peer)
        elif event == DISCONNECTED and peer.up:
            self._record_down(peer, "was lost")
            # libzmq first tries to reconnect itself for a while, but does not report that it has given up.
            peer.lost, peer.reconnect_ns = True, self._clock.monotonic_ns() + _RECONNECT_NS
        elif event == DISCONNECTED:
            self._schedule_reconnect(peer)
        else:
            self._record_failure(peer, event)

    def _record_up(self, peer: PeerConnection) -> None:
        # Two such events in a row: the first connection was dropped meanwhile.
        if peer.up:
            return
        gone_s = (self._clock.monotonic_ns() - peer.down_since_ns) * 1e-9
        again = f" again after {gone_s:.1f} s" if peer.ever_up else ""
        self._report("info", f"{peer.node} is connected{again} ({peer.endpoint})", peer, "up", gone_s=gone_s)
        peer.up = peer.ever_up = True
        peer.silent = 0
        peer.lost, peer.reconnect_ns = False, None
        peer.failures, peer.last_error = 0, ""

    def _record_down(self, peer: PeerConnection, what: str) -> None:
        if peer.up:
            now = self._clock.monotonic_ns()
            peer.up, peer.down_since_ns, peer.next_reminder_ns = False, now, now + _UNREACHED_NS
            level = "info" if is_visitor(peer.node) else "warning"
            self._report(level, f"the connection to {peer.node} ({peer.endpoint}) {what}", peer, "down")

    def _record_failure(self, peer: PeerConnection, event: int) -> None:
        peer.failures += 1
        last_error, peer.last_error = peer.last_error, FAILURES[event]
        self._rejections.record("handshake", f"{peer.node} at {peer.endpoint}: {peer.last_error}")
        self._schedule_reconnect(peer)
        if event == KEY_REFUSED:
            if last_error != peer.last_error:
                self._report("error", self._rejected_text(peer), peer, "refused")
        elif peer.failures == _REPORTED_FAILURES:
            text = (
                f"the handshake with {peer.node} ({peer.endpoint}) keeps failing: is the key of {self.machine} in "
                f"{self._access_control.keyring.allowed_path} the one it uses, and is {peer.endpoint} its endpoint?"
            )
            if is_relayed(peer.endpoint):
                text += f" Or the relay is out of reach, or {peer.node} does not run: the log of the relay's end says"
            self._report("error", text, peer, "refused")

    def _rejected_text(self, peer: PeerConnection) -> str:
        own = self._access_control
        return (
            f"{self.machine} rejects the key of {own.machine} at {peer.node} ({peer.endpoint}): on {self.machine}, run "
            f"`telenano keys allow {own.machine} '{own.public_key}' --role ...`"
        )

    def _remind(self, peer: PeerConnection, waited_s: float) -> None:
        unreached = f"{peer.node} has not been reached at {peer.endpoint} for {waited_s:.0f} s"
        if not self._active:
            text = (
                f"{peer.node} is not connected, {self._access_control.why_not(self.machine)}: run "
                f"`telenano keys allow {self.machine} KEY --role data`"
            )
        elif peer.last_error:
            text = f"{unreached}: {peer.last_error}"
        else:
            text = f"{unreached}: is {self.machine} running, is the address right, does a firewall block the port?"
        self._report("warning", text, peer, "unreached", waited_s=waited_s)

    def _report(self, level: str, text: str, peer: PeerConnection, state: str, **data: float) -> None:
        facts: dict[str, bool | float | str] = {"peer": peer.node, "endpoint": peer.endpoint, "connection": state}
        if self._is_reported:
            self._events.append(ConnectionEvent(level, text, {**facts, **data}))

"""The connecting side: connections to nodes of other machines, their state, and the messages permitted on them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import zmq

from telenano.runtime.bus.address_book import is_relayed, may_carry
from telenano.runtime.bus.bus import Subscriber
from telenano.runtime.bus.hearing import Connections, NodeConnection
from telenano.runtime.bus.socket_monitor import CONNECTED, ENDS, FAILURES, KEY_REFUSED, MonitorEvent, RejectionCounter
from telenano.runtime.security.access_control import AccessControl
from telenano.runtime.security.keyring import Role
from telenano.timing.clock import Clock
from telenano.wire.codec import WireError
from telenano.wire.nodes import is_visitor

_UNREACHED_NS = 5_000_000_000
_REMIND_NS = 60_000_000_000
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


@dataclass(kw_only=True)
class PeerConnection(NodeConnection):
    """The state of a connection to a node of another machine; times on the monotonic clock [ns]."""

    next_reminder_ns: int
    ever_up: bool = False
    failures: int = 0
    last_error: str = ""


class PeerConnections(Connections[PeerConnection]):
    """The connections to the nodes of one machine, which share a socket."""

    _events_wanted = ENDS
    # libzmq does not connect again after a rejected key or a wrong protocol; but the key may have been allowed
    # meanwhile, or the right program started. After a lost connection it first has time for a handshake of its own.
    _looks = 3

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
        now = clock.monotonic_ns()
        made = [
            PeerConnection(endpoint, node=node, since_ns=now, next_reminder_ns=now + _UNREACHED_NS)
            for node, endpoint in endpoints.items()
        ]
        super().__init__(subscriber, clock, made)
        self._replaces_silent = expects_beacon and not access_control.requires_keys
        self._is_reported = is_reported
        self.machine = machine
        self.permissions = MessagePermissions(machine, list(endpoints), access_control.roles(machine))
        self._access_control = access_control
        self._rejections = rejections
        self._active = False
        self._server_key: bytes | None = None
        if access_control.requires_keys:
            subscriber.permit = self.permissions
        self.apply_permissions()

    @property
    def sockets(self) -> list["zmq.Socket[bytes]"]:
        """The sockets that become readable when there is a monitor event."""
        return [self.monitor.socket]

    def apply_permissions(self) -> None:
        """Apply the current roles and key of the machine: connect, or close connections that are no longer allowed."""
        roles, server_key = self._access_control.roles(self.machine), self._access_control.server_key(self.machine)
        self.permissions.change(roles)
        if self._active and (not roles or server_key != self._server_key):
            self._disconnect()
        if roles and not self._active:
            self._connect(server_key)

    def look(self, now_ns: int) -> None:
        """Make connections again that libzmq has given up, and report peers that have not been reached."""
        super().look(now_ns)
        for peer in self.connections:
            if not peer.up and not is_visitor(peer.node) and now_ns >= peer.next_reminder_ns:
                peer.next_reminder_ns = now_ns + _REMIND_NS
                self._remind(peer, (now_ns - peer.since_ns) * 1e-9)

    def _connect(self, server_key: bytes | None) -> None:
        own = self._access_control.own
        if own is not None and server_key is not None:
            self.subscriber.socket.set(zmq.CURVE_PUBLICKEY, own.public)
            self.subscriber.socket.set(zmq.CURVE_SECRETKEY, own.secret)
            self.subscriber.socket.set(zmq.CURVE_SERVERKEY, server_key)
        for peer in self.connections:
            peer.failures, peer.last_error, peer.detached = 0, "", False
            peer.begin()
            self.subscriber.socket.connect(peer.endpoint)
        self._active, self._server_key = True, server_key

    def _disconnect(self) -> None:
        self._active = False
        for peer in self.connections:
            self._let_go(peer)
            self._record_down(peer, f"was closed: the key of {self.machine} that it used is no longer allowed")
            peer.begin()

    def _record(self, connection: PeerConnection, event: MonitorEvent) -> None:
        was_up = connection.up
        if event.kind in FAILURES:
            self._record_failure(connection, event.kind)
        elif event.kind == CONNECTED:
            self._record_up(connection)
        elif was_up:
            self._record_down(connection, "was lost")
        connection.record(event.kind)
        if connection.ended and not was_up:
            # libzmq would try again ten times a second.
            self._let_go(connection)

    def _note_silent(self, connection: PeerConnection) -> None:
        self._record_down(connection, "brings no message that can be read: connecting again")

    def _record_up(self, peer: PeerConnection) -> None:
        # Two such events in a row: the first connection was dropped meanwhile.
        if peer.up:
            return
        now_ns = self._clock.monotonic_ns()
        gone_s = (now_ns - peer.since_ns) * 1e-9
        again = f" again after {gone_s:.1f} s" if peer.ever_up else ""
        self._report("info", f"{peer.node} is connected{again} ({peer.endpoint})", peer, "up", gone_s=gone_s)
        peer.ever_up, peer.since_ns, peer.silent = True, now_ns, 0
        peer.failures, peer.last_error = 0, ""

    def _record_down(self, peer: PeerConnection, what: str) -> None:
        if peer.up:
            now_ns = self._clock.monotonic_ns()
            peer.up, peer.since_ns, peer.next_reminder_ns = False, now_ns, now_ns + _UNREACHED_NS
            level = "info" if is_visitor(peer.node) else "warning"
            self._report(level, f"the connection to {peer.node} ({peer.endpoint}) {what}", peer, "down")

    def _record_failure(self, peer: PeerConnection, kind: int) -> None:
        peer.failures += 1
        last_error, peer.last_error = peer.last_error, FAILURES[kind]
        self._rejections.record("handshake", f"{peer.node} at {peer.endpoint}: {peer.last_error}")
        if kind == KEY_REFUSED:
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

    def _report(self, level: str, text: str, connection: PeerConnection, state: str, **data: float) -> None:
        if self._is_reported:
            super()._report(level, text, connection, state, **data)

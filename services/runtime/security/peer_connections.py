"""The side that connects: lines to the nodes of another machine, what may be said on them, and what became of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import zmq

from proto import WireError
from proto.nodes import is_visitor
from services.runtime.address_book import may_carry
from services.runtime.bus import ConnectionEvent, Subscriber
from services.runtime.clock import Clock
from services.runtime.security.access_control import AccessControl
from services.runtime.security.keyring import Role
from services.runtime.security.socket_monitor import (
    CLOSED_IN_HANDSHAKE,
    CONNECTED,
    DISCONNECTED,
    FAILURES,
    KEY_REFUSED,
    PROTOCOL_FAILED,
    Monitor,
    RejectionCounter,
)

# libzmq does not try again where a key was refused or something else than its protocol was spoken, without saying so:
# the key may be allowed meanwhile, and the right program have been started
_ASK_AGAIN_NS = 2_000_000_000
_UNREACHED_NS = 5_000_000_000
_REMIND_NS = 60_000_000_000
# failed handshakes in a row that are no accident
_NO_ACCIDENT = 3
_EVENTS = CONNECTED | CLOSED_IN_HANDSHAKE | PROTOCOL_FAILED | KEY_REFUSED | DISCONNECTED
# pairs of topic and source remembered as permitted; a peer that makes up names must not fill the memory
_MOST_REMEMBERED = 4096


class MessagePermissions:
    """What may be said on the lines to one machine: topics by its roles, sources by its nodes."""

    def __init__(self, machine: str, nodes: Sequence[str], roles: Sequence[Role]) -> None:
        self.machine = machine
        self._nodes = list(nodes)
        self._roles = frozenset(roles)
        self._fine: set[tuple[str, str]] = set()

    def change(self, roles: Sequence[Role]) -> None:
        """Put other roles into force."""
        self._roles = frozenset(roles)
        self._fine.clear()

    def __call__(self, topic: str, src: str) -> None:
        """Raise WireError (`role`, `source`) for a message that this machine may not send."""
        # asked a thousand times a second for a few pairs
        if (topic, src) in self._fine:
            return
        needed: Role = "control" if topic == "session/control" else "data"
        if needed not in self._roles:
            has = ", ".join(sorted(self._roles)) or "none"
            raise WireError("role", f"{topic} of {src}: the machine {self.machine} lacks the role {needed}, has {has}")
        if not any(may_carry(node, src) for node in self._nodes):
            raise WireError("source", f"{topic}: the machine {self.machine} may not speak for {src}")
        if len(self._fine) < _MOST_REMEMBERED:
            self._fine.add((topic, src))


@dataclass
class PeerConnection:
    """A connection to a node of another machine as it is now; times on the monotonic clock [ns]."""

    node: str
    endpoint: str
    waiting_ns: int
    remind_ns: int
    up: bool = False
    ever_up: bool = False
    failures: int = 0
    trouble: str = ""
    # the connection is no more, but still on the list of libzmq
    lost: bool = False
    # when to connect anew, where that is not left to libzmq
    again_ns: int | None = None


class PeerConnections:
    """The connections to the nodes of one machine, which share a socket."""

    def __init__(
        self,
        machine: str,
        endpoints: Mapping[str, str],
        subscriber: Subscriber,
        clock: Clock,
        trust: AccessControl,
        refusals: RejectionCounter,
    ) -> None:
        """Take the endpoint of each node and the subscriber that is to be connected to them."""
        now = clock.monotonic_ns()
        self.machine = machine
        self.subscriber = subscriber
        self.monitor = Monitor(subscriber.socket, _EVENTS)
        self.rights = MessagePermissions(machine, list(endpoints), trust.roles(machine))
        self._clock = clock
        self._trust = trust
        self._refusals = refusals
        self._connected = False
        self._server_key: bytes | None = None
        self._notices: list[ConnectionEvent] = []
        self.lines = [PeerConnection(node, endpoint, now, now + _UNREACHED_NS) for node, endpoint in endpoints.items()]
        if trust.locked:
            subscriber.permit = self.rights
        self.review()

    @property
    def sockets(self) -> list["zmq.Socket[bytes]"]:
        """What becomes readable when something became of a connection."""
        return [self.monitor.socket]

    def attend(self) -> bool:
        """Note what became of the connections; True when more is left to do."""
        for event, endpoint in self.monitor.events():
            line = self._line(endpoint)
            if line is not None:
                self._enter(line, event)
        return self.monitor.has_pending

    def take_notices(self) -> list[ConnectionEvent]:
        """Give what was noted since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def review(self) -> None:
        """Put the rights of the machine, as they are now, into force: connect, or close what is open."""
        roles, server_key = self._trust.roles(self.machine), self._trust.server_key(self.machine)
        self.rights.change(roles)
        if self._connected and (not roles or server_key != self._server_key):
            self._disconnect()
        if roles and not self._connected:
            self._connect(server_key)

    def look(self, now_ns: int) -> None:
        """Try again where libzmq does not, and remind of what has not been reached."""
        # to disconnect drops what was not read yet, such as the last words of a node
        if self.subscriber.drained:
            self._dial(now_ns)
        for line in self.lines:
            if not line.up and not is_visitor(line.node) and now_ns >= line.remind_ns:
                line.remind_ns = now_ns + _REMIND_NS
                self._remind(line, (now_ns - line.waiting_ns) * 1e-9)

    def _dial(self, now_ns: int) -> None:
        due = [line for line in self.lines if line.again_ns is not None and now_ns >= line.again_ns]
        # first: libzmq knows what it has given up by a place in memory that the next connection may get
        for line in self.lines if due else ():
            if line.lost:
                line.lost = False
                self.subscriber.socket.disconnect(line.endpoint)
        for line in due:
            line.again_ns = None
            self.subscriber.socket.connect(line.endpoint)

    def _give_up(self, line: PeerConnection) -> None:
        if line.again_ns is None or line.lost:
            self.subscriber.socket.disconnect(line.endpoint)
        line.lost, line.again_ns = False, self._clock.monotonic_ns() + _ASK_AGAIN_NS

    def _connect(self, server_key: bytes | None) -> None:
        own = self._trust.own
        if own is not None and server_key is not None:
            self.subscriber.socket.set(zmq.CURVE_PUBLICKEY, own.public)
            self.subscriber.socket.set(zmq.CURVE_SECRETKEY, own.secret)
            self.subscriber.socket.set(zmq.CURVE_SERVERKEY, server_key)
        for line in self.lines:
            line.failures, line.trouble = 0, ""
            self.subscriber.socket.connect(line.endpoint)
        self._connected, self._server_key = True, server_key

    def _disconnect(self) -> None:
        self._connected = False
        for line in self.lines:
            if line.again_ns is None or line.lost:
                self.subscriber.socket.disconnect(line.endpoint)
            line.lost, line.again_ns = False, None
            self._enter_down(line, f"was closed: the key of {self.machine} that it had is no longer allowed")

    def _line(self, endpoint: str) -> PeerConnection | None:
        """Give the line of an endpoint as libzmq names it: of a host name it may have made an address."""
        exact = [line for line in self.lines if line.endpoint == endpoint]
        port = endpoint.rpartition(":")[2]
        return next(iter(exact or [line for line in self.lines if line.endpoint.rpartition(":")[2] == port]), None)

    def _enter(self, line: PeerConnection, event: int) -> None:
        # of a connection that was closed here something may come late
        if not self._connected:
            return
        if event == CONNECTED:
            self._enter_up(line)
        elif event == DISCONNECTED and line.up:
            self._enter_down(line, "is lost")
            # left to libzmq for a while, which does not say whether it tries
            line.lost, line.again_ns = True, self._clock.monotonic_ns() + _ASK_AGAIN_NS
        elif event == DISCONNECTED:
            self._give_up(line)
        else:
            self._enter_failure(line, event)

    def _enter_up(self, line: PeerConnection) -> None:
        # two in a row: libzmq came first with a connection that was given up meanwhile
        if line.up:
            return
        gone_s = (self._clock.monotonic_ns() - line.waiting_ns) * 1e-9
        text = f"{line.node} is connected again after {gone_s:.1f} s" if line.ever_up else f"{line.node} is connected"
        self._tell("info", f"{text} ({line.endpoint})", line, "up", gone_s=gone_s)
        line.up = line.ever_up = True
        line.lost, line.again_ns = False, None
        line.failures, line.trouble = 0, ""

    def _enter_down(self, line: PeerConnection, what: str) -> None:
        if line.up:
            now = self._clock.monotonic_ns()
            line.up, line.waiting_ns, line.remind_ns = False, now, now + _UNREACHED_NS
            level = "info" if is_visitor(line.node) else "warning"
            self._tell(level, f"the connection to {line.node} ({line.endpoint}) {what}", line, "down")

    def _enter_failure(self, line: PeerConnection, event: int) -> None:
        line.failures += 1
        known, line.trouble = line.trouble, FAILURES[event]
        self._refusals.enter("handshake", f"{line.node} at {line.endpoint}: {line.trouble}")
        self._give_up(line)
        if event == KEY_REFUSED:
            if known != line.trouble:
                self._tell("error", self._refused_text(line), line, "refused")
        elif line.failures == _NO_ACCIDENT:
            text = (
                f"{line.node} ({line.endpoint}) does not agree on keys: is that of {self.machine} in "
                f"{self._trust.keyring.allowed_path} the one it has, and is {line.endpoint} really {self.machine}?"
            )
            self._tell("error", text, line, "refused")

    def _refused_text(self, line: PeerConnection) -> str:
        return (
            f"{self.machine} refuses the key of {self._trust.machine} at {line.node} ({line.endpoint}): there, "
            f"`telenano keys allow {self._trust.machine} '{self._trust.public_key}' --role ...`"
        )

    def _remind(self, line: PeerConnection, waited_s: float) -> None:
        unreached = f"{line.node} has not been reached at {line.endpoint} for {waited_s:.0f} s"
        if not self._connected:
            text = (
                f"{line.node} is not listened to, no valid key of {self.machine} is in "
                f"{self._trust.keyring.allowed_path}: `telenano keys allow {self.machine} KEY --role data`"
            )
        elif line.trouble:
            text = f"{unreached}: {line.trouble}"
        else:
            text = f"{unreached}: is {self.machine} running, is the address right, does a firewall close the port?"
        self._tell("warning", text, line, "unreached", waited_s=waited_s)

    def _tell(self, level: str, text: str, line: PeerConnection, connection: str, **data: float) -> None:
        facts: dict[str, bool | float | str] = {"peer": line.node, "endpoint": line.endpoint, "connection": connection}
        self._notices.append(ConnectionEvent(level, text, {**facts, **data}))

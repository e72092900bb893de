"""The side that is connected to: sockets that other machines may knock at, and who is let in."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import zmq

from services.runtime.bus import ConnectionEvent, ZmqPublisher
from services.runtime.security.access_control import AccessControl
from services.runtime.security.keyring import key_text
from services.runtime.security.socket_monitor import (
    CLOSED_IN_HANDSHAKE,
    FAILURES,
    PROTOCOL_FAILED,
    Monitor,
    RejectionCounter,
)

# of ZeroMQ's authentication protocol (ZAP)
_ZAP_ENDPOINT = "inproc://zeromq.zap.01"
_ACCEPTED, _DENIED = b"200", b"400"
_ZAP_FRAMES = 9
# strangers answered in a turn of the node's loop, at 40 to 120 us each; libzmq's thread takes longer for each of them
_AT_ONCE = 4
# turns in which a door that was shut is tried again without delay
_HURRIED = 1000
_WHY = {"unlisted": "is not in the list", "revoked": "was revoked"}


@dataclass
class BoundEndpoint:
    """A publisher that other machines may connect to."""

    publisher: ZmqPublisher
    monitor: Monitor
    endpoint: str
    accepted: set[str] = field(default_factory=set)
    unbound: bool = False
    attempts: int = 0

    @property
    def node(self) -> str:
        """The node whose socket it is."""
        return self.publisher.node


class ZapAuthenticator:
    """Answers libzmq's question, for each key that knocks, whether it may come in; and shuts out who may no longer."""

    def __init__(
        self, context: "zmq.Context[zmq.Socket[bytes]]", trust: AccessControl, refusals: RejectionCounter
    ) -> None:
        """Take the post; before any socket can be knocked at."""
        self.doors: list[BoundEndpoint] = []
        self._notices: list[ConnectionEvent] = []
        self._trust = trust
        self._refusals = refusals
        self.socket: zmq.Socket[bytes] | None = None
        if trust.locked:
            self.socket = context.socket(zmq.ROUTER)
            self.socket.set(zmq.LINGER, 0)
            self.socket.bind(_ZAP_ENDPOINT)

    def lock(self, socket: "zmq.Socket[bytes]", node: str) -> None:
        """Have what a socket binds from now on ask for a key."""
        if self._trust.own is not None:
            socket.set(zmq.CURVE_SERVER, 1)
            socket.set(zmq.CURVE_SECRETKEY, self._trust.own.secret)
            # tells which door was knocked at
            socket.set(zmq.ZAP_DOMAIN, node.encode())
            # without this libzmq lets everybody in while nobody is at the post, as when a process ends
            socket.set(zmq.ZAP_ENFORCE_DOMAIN, 1)

    def watch(self, publisher: ZmqPublisher) -> None:
        """Look after a publisher whose last endpoint is one for other machines."""
        bound = publisher.socket.getsockopt_string(zmq.LAST_ENDPOINT).rstrip("\0")
        self.doors.append(
            BoundEndpoint(publisher, Monitor(publisher.socket, CLOSED_IN_HANDSHAKE | PROTOCOL_FAILED), bound)
        )

    @property
    def sockets(self) -> list["zmq.Socket[bytes]"]:
        """What becomes readable when somebody knocks."""
        return [*([] if self.socket is None else [self.socket]), *(door.monitor.socket for door in self.doors)]

    def attend(self) -> bool:
        """Answer who has knocked; True when more is left to do."""
        left = self.socket is not None and self._answer(self.socket)
        for door in self.doors:
            for event, _ in door.monitor.events():
                self._refusals.enter("handshake", f"somebody at {door.node}: {FAILURES[event]}")
            left |= door.monitor.has_pending
            if door.unbound:
                left |= self._bind_again(door)
        return left

    def take_notices(self) -> list[ConnectionEvent]:
        """Give what was noted since the last call."""
        notices, self._notices = self._notices, []
        return notices

    def review(self) -> None:
        """Close the doors through which somebody came who may no longer; who may comes back by itself."""
        for door in self.doors:
            gone = {key for key in door.accepted if self._trust.judge(key)[1]}
            if gone:
                self._shut(door, {self._trust.judge(key)[0] or "a machine taken off the list" for key in gone})

    def _answer(self, socket: "zmq.Socket[bytes]") -> bool:
        for _ in range(_AT_ONCE):
            try:
                frames = socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return False
            socket.send_multipart(self._answer_to(frames))
        return True

    def _answer_to(self, frames: Sequence[bytes]) -> list[bytes]:
        # identity of the asking session, empty, version, request, domain, address, identity, mechanism, key
        back, version, request = frames[0], frames[2], frames[3]
        if len(frames) != _ZAP_FRAMES or frames[7] != b"CURVE":
            self._refusals.enter("handshake", "somebody knocked without a key")
            return [back, b"", version, request, _DENIED, b"a key is needed", b"", b""]
        node, address, key = frames[4].decode(), frames[5].decode(), key_text(frames[8])
        name, refusal = self._trust.judge(key)
        if refusal:
            self._refusals.enter(refusal, f"{name or 'somebody'} ({address}) at {node}: the key {key} {_WHY[refusal]}")
            return [back, b"", version, request, _DENIED, refusal.encode(), b"", b""]
        for door in self.doors:
            if door.node == node:
                door.accepted.add(key)
        return [back, b"", version, request, _ACCEPTED, b"", name.encode(), b""]

    def _shut(self, door: BoundEndpoint, names: Iterable[str]) -> None:
        door.accepted.clear()
        if not door.unbound:
            # libzmq cannot close one connection; unbinding closes all that came through this endpoint
            door.publisher.socket.unbind(door.endpoint)
            door.unbound, door.attempts = True, 0
        text = f"the key of {', '.join(sorted(names))} is no longer allowed: all network connections at {door.node} "
        self._notices.append(
            ConnectionEvent("warning", f"{text}were closed", {"endpoint": door.endpoint, "connection": "revoked"})
        )
        self._bind_again(door)

    def _bind_again(self, door: BoundEndpoint) -> bool:
        """Open a door that was shut; True when the next turn is to try again."""
        try:
            door.publisher.socket.bind(door.endpoint)
        except zmq.ZMQError as error:
            # the old listener is closed by a thread of libzmq's, a moment later; all else takes longer
            door.attempts += 1
            if door.attempts == _HURRIED:
                text = f"{door.node} cannot bind {door.endpoint} again: {error.strerror}; it is tried twice a second"
                self._notices.append(
                    ConnectionEvent("error", text, {"endpoint": door.endpoint, "connection": "unbound"})
                )
            return door.attempts < _HURRIED
        door.unbound = False
        return False

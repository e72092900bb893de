"""The binding side: accepts or rejects CURVE clients by public key, and disconnects those whose key was revoked."""

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import zmq

from telenano.runtime.bus.bus import ConnectionEvent
from telenano.runtime.bus.publisher import ZmqPublisher
from telenano.runtime.bus.socket_monitor import (
    CLOSED_IN_HANDSHAKE,
    FAILURES,
    PROTOCOL_FAILED,
    Monitor,
    RejectionCounter,
)
from telenano.runtime.security.access_control import AccessControl
from telenano.runtime.security.keyring import key_text

# ZeroMQ's authentication protocol (ZAP) prescribes this endpoint.
_ZAP_ENDPOINT = "inproc://zeromq.zap.01"
# Status codes of ZAP.
_ACCEPTED = b"200"
_DENIED = b"400"
_ZAP_FRAMES = 9
_MECHANISM = 7
# Address of a peer at a local socket, as libzmq reports it: user, group and process. No network address has this form.
_LOCAL_PEER = re.compile(r"(?:localhost)?:([0-9]+):[0-9]+:[0-9]+")
# Most requests answered in a turn of the node's loop, at 40 to 120 us each; libzmq's thread needs longer for each.
_BATCH = 4
# Number of attempts to bind an endpoint again in consecutive turns, without delay.
_FAST_REBINDS = 1000
_REASONS = {
    "unlisted": "is not in the list",
    "revoked": "was revoked",
    "expired": "has expired",
    "relay": "is that of a relay",
}


@dataclass
class BoundEndpoint:
    """A publisher to which other machines may connect, with the public keys accepted at its endpoint."""

    publisher: ZmqPublisher
    monitor: Monitor
    endpoint: str
    accepted: set[str] = field(default_factory=set)
    unbound: bool = False
    attempts: int = 0

    @property
    def node(self) -> str:
        return self.publisher.node


class ZapAuthenticator:
    """ZAP handler: accepts or rejects CURVE clients by public key, and disconnects those whose key was revoked."""

    def __init__(
        self,
        context: "zmq.Context[zmq.Socket[bytes]]",
        access_control: AccessControl,
        rejections: RejectionCounter,
    ) -> None:
        """Bind the ZAP endpoint; this must happen before any server socket binds.

        Args:
            context: The ZeroMQ context whose server sockets are protected.
            access_control: Decides which keys are accepted.
            rejections: Counts the clients that are rejected.
        """
        self.endpoints: list[BoundEndpoint] = []
        self._monitors: dict[str, Monitor] = {}
        self._events: list[ConnectionEvent] = []
        self._access_control = access_control
        self._rejections = rejections
        self.socket: zmq.Socket[bytes] | None = None
        if access_control.requires_keys:
            self.socket = context.socket(zmq.ROUTER)
            self.socket.set(zmq.LINGER, 0)
            self.socket.bind(_ZAP_ENDPOINT)

    def prepare(self, socket: "zmq.Socket[bytes]", node: str) -> None:
        """Monitor a socket before it binds an endpoint for other machines, and make it require a key from clients."""
        self._monitors[node] = Monitor(socket, CLOSED_IN_HANDSHAKE | PROTOCOL_FAILED)
        if self._access_control.own is not None:
            socket.set(zmq.CURVE_SERVER, 1)
            socket.set(zmq.CURVE_SECRETKEY, self._access_control.own.secret)
            # The domain tells the ZAP handler to which node a client connects.
            socket.set(zmq.ZAP_DOMAIN, node.encode())
            # Without this option libzmq accepts every client while no ZAP handler is bound, such as at the end of a
            # process.
            socket.set(zmq.ZAP_ENFORCE_DOMAIN, 1)

    def add(self, publisher: ZmqPublisher) -> None:
        """Protect a prepared publisher, whose endpoint bound last is the one for other machines."""
        bound = publisher.socket.getsockopt_string(zmq.LAST_ENDPOINT).rstrip("\0")
        self.endpoints.append(BoundEndpoint(publisher, self._monitors.pop(publisher.node), bound))

    def abandon(self, node: str) -> None:
        """Close the monitor that was prepared for a socket that could not bind."""
        monitor = self._monitors.pop(node, None)
        if monitor is not None:
            monitor.close()

    def close(self) -> None:
        """Close the sockets of the ZAP handler and the monitors, which closing the publishers does not close."""
        if self.socket is not None:
            self.socket.close()
        for bound in self.endpoints:
            bound.monitor.close()

    @property
    def sockets(self) -> list["zmq.Socket[bytes]"]:
        """The sockets that become readable when there is a request or a monitor event."""
        return [*([] if self.socket is None else [self.socket]), *(bound.monitor.socket for bound in self.endpoints)]

    def process_events(self) -> bool:
        """Answer authentication requests and record failed handshakes; return True if more may be left to do."""
        left = self.socket is not None and self._answer(self.socket)
        for bound in self.endpoints:
            for event in bound.monitor.events():
                self._rejections.record("handshake", f"a client of {bound.node}: {FAILURES[event.kind]}")
            left |= bound.monitor.has_pending
            if bound.unbound:
                left |= self._bind_again(bound)
        return left

    def take_events(self) -> list[ConnectionEvent]:
        events, self._events = self._events, []
        return events

    def apply_permissions(self) -> None:
        """Close the endpoints used by a client whose key is no longer allowed; the other clients reconnect."""
        for bound in self.endpoints:
            gone = {key for key in bound.accepted if self._access_control.authorize(key)[1]}
            if gone:
                names = {self._access_control.authorize(key)[0] or "a machine removed from the list" for key in gone}
                self._close_connections(bound, names)

    def _report(self, bound: BoundEndpoint, level: str, text: str, state: str) -> None:
        self._events.append(ConnectionEvent(level, text, {"endpoint": bound.endpoint, "connection": state}))

    def _answer(self, socket: "zmq.Socket[bytes]") -> bool:
        for _ in range(_BATCH):
            try:
                frames = socket.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return False
            socket.send_multipart(self._reply_to(frames))
        return True

    def _reply_to(self, frames: Sequence[bytes]) -> list[bytes]:
        # The frames are: identity of the requesting session, empty, version, request, domain, address, identity,
        # mechanism, key.
        back, version, request = frames[0], frames[2], frames[3]
        if len(frames) > _MECHANISM and frames[_MECHANISM] == b"NULL" and _is_of_this_user(frames[5].decode()):
            # The client came by the ipc endpoint of a node, which was bound again (`ipc_listener.py`) and has no keys.
            return [back, b"", version, request, _ACCEPTED, b"", b"", b""]
        if len(frames) != _ZAP_FRAMES or frames[_MECHANISM] != b"CURVE":
            self._rejections.record("handshake", "a client connected without a key")
            return [back, b"", version, request, _DENIED, b"a key is needed", b"", b""]
        node, address, key = frames[4].decode(), frames[5].decode(), key_text(frames[8])
        name, reason = self._access_control.authorize(key)
        if reason:
            client = name or "an unknown machine"
            self._rejections.record(reason, f"{client} ({address}) at {node}: the key {key} {_REASONS[reason]}")
            return [back, b"", version, request, _DENIED, reason.encode(), b"", b""]
        for bound in self.endpoints:
            if bound.node == node:
                bound.accepted.add(key)
        return [back, b"", version, request, _ACCEPTED, b"", name.encode(), b""]

    def _close_connections(self, bound: BoundEndpoint, names: Iterable[str]) -> None:
        bound.accepted.clear()
        if not bound.unbound:
            # libzmq cannot close a single connection; unbinding closes all connections of this endpoint.
            bound.publisher.socket.unbind(bound.endpoint)
            bound.unbound, bound.attempts = True, 0
        text = f"the key of {', '.join(sorted(names))} is no longer allowed: all network connections at {bound.node} "
        self._report(bound, "warning", f"{text}were closed", "revoked")
        self._bind_again(bound)

    def _bind_again(self, bound: BoundEndpoint) -> bool:
        """Bind an endpoint that was unbound; return True if the next turn has to try again at once."""
        try:
            bound.publisher.socket.bind(bound.endpoint)
        except zmq.ZMQError as error:
            # A thread of libzmq closes the old listener a moment later; any other obstacle lasts longer.
            bound.attempts += 1
            if bound.attempts == _FAST_REBINDS:
                text = f"{bound.node} cannot bind {bound.endpoint} again: {error.strerror}; retrying twice a second"
                self._report(bound, "error", text, "unbound")
            return bound.attempts < _FAST_REBINDS
        bound.unbound = False
        return False


def _is_of_this_user(address: str) -> bool:
    """Return whether a peer is a process of this user or root on this machine, by the address that libzmq reports."""
    peer = _LOCAL_PEER.fullmatch(address)
    return peer is not None and int(peer[1]) in (os.geteuid(), 0)

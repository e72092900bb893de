"""Choose where an end of the link sends its datagrams if both ends can only dial out: to a relay, or directly.

The end asks the relay for a place, and is joined with the end of the other machine that asked for this one. The relay
tells each end the address at which it sees the other. Both ends ping that address at the same time, which opens the way
through most routers (hole punching). An end whose ping was answered by the other end sends there from then on, and
returns to the relay when the answers stop. Until then samples go through the relay, so that no attempt delays them.
"""

import os
from collections.abc import Callable
from typing import Any

from telenano_wide_area.relay.protocol import (
    ANSWER,
    COOKIE,
    COOKIE_BYTES,
    PING,
    PONG,
    SharedKeys,
    make_request,
    request_bytes,
    unpack,
)
from telenano_wide_area.sealed import RejectedError

Address = tuple[Any, ...]
Send = Callable[[bytes, Address], None]

TAG_BYTES = 4
# Requests are sent at this interval until both ends have places, and while no sample arrives.
_ASK_NS = 200_000_000
# Requests are sent at this interval afterwards: they keep the path through the routers open, and show when the relay
# has forgotten the place.
_CALM_ASK_NS = 2_000_000_000
# The other end counts as silent after this time without a sample.
_SILENCE_NS = 150_000_000
# Pings are sent at this interval on the direct path, and for _EAGER_NS after a change.
_PING_NS = 100_000_000
# Pings are sent at this interval otherwise.
_CALM_PING_NS = 5_000_000_000
# Pings stay frequent for this time after a change.
_EAGER_NS = 5_000_000_000
# A direct path without samples is given up after this time without an answer.
_UNANSWERED_NS = 300_000_000
# A direct path with samples is given up after this time without an answer.
_LOST_NS = 2_000_000_000
_PING_BYTES = 8
# Answers to this number of the newest pings are accepted.
_REMEMBERED_PINGS = 16


class RelayPath:
    """The path of the datagrams of one end; `peer` is the address to send to, None before the relay gives a place."""

    def __init__(
        self,
        relay: Address,
        keys: SharedKeys,
        peer_keys: SharedKeys,
        own_public: bytes,
        peer_public: bytes,
        *,
        direct: bool = True,
    ) -> None:
        """Begin without a place.

        Args:
            relay: The address of the relay.
            keys: The keys that this machine shares with the relay.
            peer_keys: The keys that this machine shares with the other machine.
            own_public: The public key of this machine, 32 bytes.
            peer_public: The public key of the other machine, 32 bytes.
            direct: Whether the direct path is tried; the relay then tells the other end the address of this one.
        """
        # The kernel drops datagrams without a known tag, so control datagrams for this end begin with this one.
        self.tag = os.urandom(TAG_BYTES)
        self.relay = relay
        self.peer: Address | None = None
        self.send: Send = lambda datagram, address: None
        self._keys, self._peer_keys = keys, peer_keys
        self._own_public, self._peer_public = own_public, peer_public
        self._direct = direct
        self._cookie = bytes(COOKIE_BYTES)
        self._awaits_answer = False
        self._asked_ns = self._answered_ns = -_CALM_ASK_NS
        # Possible direct addresses of the other end: the one that the relay sees, and the one from which a ping came.
        self._candidates: dict[str, Address] = {}
        self._peer_tag = b""
        self._pings: list[bytes] = []
        self._pinged_ns = self._changed_ns = self._ponged_ns = -_CALM_PING_NS
        self._now_ns = 0

    @property
    def is_direct(self) -> bool:
        """Whether samples are sent directly, not through the relay."""
        return self.peer is not None and self.peer != self.relay

    def maintain(self, now_ns: int, silence_ns: int) -> None:
        """Ask for a place, try the direct path, and give it up if no answer comes there.

        Args:
            now_ns: The time now [ns].
            silence_ns: The time since the last sample of the other end [ns].
        """
        self._now_ns = now_ns
        silent = silence_ns > _SILENCE_NS
        unanswered_ns = now_ns - self._ponged_ns
        if self.is_direct and unanswered_ns > (_UNANSWERED_NS if silent else _LOST_NS):
            self.peer, self._changed_ns = self.relay, now_ns
        if now_ns - self._asked_ns >= (_CALM_ASK_NS if self._peer_tag and not silent else _ASK_NS):
            self._ask()
        eager = self.is_direct or now_ns - self._changed_ns < _EAGER_NS
        if self._direct and self._peer_tag and now_ns - self._pinged_ns >= (_PING_NS if eager else _CALM_PING_NS):
            self._pinged_ns = now_ns
            ping = os.urandom(_PING_BYTES)
            self._pings = [*self._pings[1 - _REMEMBERED_PINGS :], ping]
            for address in {self.peer} if self.is_direct else set(self._candidates.values()):
                if address is not None:
                    self._say(PING, ping, address)

    def take(self, datagram: bytes, address: Address) -> None:
        """Handle a datagram with the tag; RejectedError if it is neither the relay's nor the other end's."""
        kind, rest = datagram[TAG_BYTES : TAG_BYTES + 1], datagram[TAG_BYTES + 1 :]
        if kind in (PING, PONG) and not self._direct:
            raise RejectedError("unknown_key")
        if kind == PING:
            ping = self._peer_keys.open(rest, PING + self.tag)
            self._say(PONG, ping, address)
            self._consider("heard", address)
        elif kind == PONG:
            ping = self._peer_keys.open(rest, PONG + self.tag)
            if ping not in self._pings:
                raise RejectedError("replayed")
            self._ponged_ns = self._now_ns
            self.peer = address
        elif address[:2] != self.relay[:2]:
            raise RejectedError("unknown_key")
        elif kind == COOKIE and len(rest) == COOKIE_BYTES:
            # A cookie is accepted once for each request that the end makes by itself, so that a forger cannot make it
            # send more.
            if self._awaits_answer:
                self._cookie = rest
                self._ask()
                self._awaits_answer = False
        elif kind == ANSWER:
            self._place(unpack(self._keys.open(rest, self.tag + self._cookie)))
        else:
            raise RejectedError("malformed")

    def _ask(self) -> None:
        self._asked_ns, self._awaits_answer = self._now_ns, True
        request = make_request(
            self._keys, self.tag, self._cookie, self._own_public, self._peer_public, direct=self._direct
        )
        self.send(request_bytes(request), self.relay)

    def _place(self, answer: dict[str, Any]) -> None:
        """Record the place that the relay has given, and its information about the other end."""
        self.peer = self.peer or self.relay
        try:
            tag, (host, port) = bytes.fromhex(answer["tag"]), answer["peer"] or ("", 0)
        except (KeyError, TypeError, ValueError):
            raise RejectedError("malformed") from None
        if not isinstance(host, str) or not isinstance(port, int) or not 0 <= port < 65536:
            raise RejectedError("malformed")
        if len(tag) == TAG_BYTES and tag != self._peer_tag:
            # The other end is a new one.
            self._peer_tag, self._changed_ns, self._candidates = tag, self._now_ns, {}
        if host and self._peer_tag:
            self._consider("seen", (host, port, *self.relay[2:]))

    def _consider(self, source: str, address: Address) -> None:
        if address[:2] != self.relay[:2] and self._candidates.get(source) != address:
            self._candidates[source], self._changed_ns = address, self._now_ns

    def _say(self, kind: bytes, ping: bytes, address: Address) -> None:
        if self._peer_tag:
            self.send(self._peer_tag + kind + self._peer_keys.seal(ping, kind + self._peer_tag), address)

"""Forward datagrams at a relay: each from the address of one end to that of the other, unchanged.

An end gets a place only after it has proved its key, and that it receives at its own address: it has to return the
cookie of the first answer. No datagram makes the relay send more bytes than it received, except to a known end.
"""

import asyncio
import hashlib
import hmac
import os
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from telenano.runtime import KeyPair
from telenano_wide_area.relay.channel import Budget
from telenano_wide_area.relay.protocol import (
    COOKIE,
    COOKIE_BYTES,
    MAGIC,
    TO_RELAY,
    SharedKeys,
    answer_bytes,
    parse_request,
    raw_key,
    unpack,
)
from telenano_wide_area.sealed import MOST_BYTES, RejectedError

Address = tuple[Any, ...]
Pair = tuple[bytes, bytes]

# An end asks every two seconds; after this time without a request its place is removed [s].
PLACE_S = 15.0
# A cookie is valid for one to two of these [s].
_COOKIE_S = 120.0
# Answers a second to all clients without a cookie together; each is a tenth as long as the request.
_COOKIES_PER_S = 200.0
# The most places of a machine, one for each machine that it works with.
_MOST_PLACES = 16
_BATCH = 64
_BUFFER_BYTES = 1 << 21


@dataclass
class Place:
    """An end at the relay: the pair of keys (its own, that of the end it asks for), its address and its tag."""

    pair: Pair
    address: Address
    tag: bytes
    asked_s: float
    direct: bool = True


class Forwarder:
    """The places of a relay, and the datagrams between them."""

    def __init__(
        self,
        own: KeyPair,
        is_allowed: Callable[[bytes], bool],
        budget_of: Callable[[bytes], Budget],
        now_s: Callable[[], float],
    ) -> None:
        """Begin without a place.

        Args:
            own: The key pair of the relay.
            is_allowed: Returns whether the machine with a public key may use the relay.
            budget_of: Returns the budget of bytes of a machine.
            now_s: Returns the monotonic time [s].
        """
        self.carried = 0
        self.refused: dict[str, int] = {}
        # Takes each datagram for this machine itself, with the key of the end that sent it; None if it takes none.
        self.deliver: Callable[[bytes, bytes], None] | None = None
        self.places: dict[Pair, Place] = {}
        self._by_address: dict[Address, Place] = {}
        self._own_public = raw_key(own.public)
        self._own, self._is_allowed, self._budget_of, self._now_s = own, is_allowed, budget_of, now_s
        self._keys: dict[bytes, SharedKeys] = {}
        self._secret = os.urandom(32)
        self._cookies = Budget(_COOKIES_PER_S, _COOKIES_PER_S, now_s())
        self._socket: socket.socket | None = None

    def open(self, host: str, port: int) -> None:
        """Bind the UDP port and begin to forward; OSError if it cannot be bound."""
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        opened = socket.socket(family, socket.SOCK_DGRAM)
        try:
            opened.setblocking(False)
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
            opened.bind(address)
        except OSError:
            opened.close()
            raise
        self._socket = opened
        asyncio.get_running_loop().add_reader(opened.fileno(), self._read)

    def close(self) -> None:
        """Close the port."""
        if self._socket is not None:
            asyncio.get_running_loop().remove_reader(self._socket.fileno())
            self._socket.close()
            self._socket = None

    def tidy(self) -> None:
        """Remove the places of ends that no longer ask or are no longer allowed."""
        now_s = self._now_s()
        for place in list(self.places.values()):
            if now_s - place.asked_s > PLACE_S or not self._is_allowed(place.pair[0]):
                self._remove(place)
        self._keys = {public: keys for public, keys in self._keys.items() if self._is_allowed(public)}

    def take(self, datagram: bytes, address: Address) -> tuple[bytes, Address] | None:
        """Return the datagram that the relay sends for one that arrived, and its destination; None for none."""
        place = self._by_address.get(address)
        try:
            if datagram.startswith(MAGIC):
                return self._ask(datagram, address), address
            if place is None:
                raise RejectedError("unknown_address")
            if len(datagram) > MOST_BYTES:
                raise RejectedError("oversized")
            other = self.places.get(place.pair[::-1])
            is_own = self.deliver is not None and place.pair[1] == self._own_public
            if other is None and not is_own:
                raise RejectedError("alone")
            if not self._budget_of(place.pair[0]).take(len(datagram), self._now_s()):
                raise RejectedError("budget")
        except RejectedError as error:
            self.refused[error.cause] = self.refused.get(error.cause, 0) + 1
            return None
        self.carried += 1
        if other is not None:
            return datagram, other.address
        if self.deliver is not None:
            self.deliver(place.pair[0], datagram)
        return None

    def send(self, public: bytes, datagram: bytes) -> bool:
        """Send a datagram of this machine itself to an end that asked for it; return whether there is one."""
        place = self.places.get((public, self._own_public))
        if place is None or self._socket is None:
            return False
        try:
            self._socket.sendto(datagram, place.address)
        except OSError:
            self.refused["send"] = self.refused.get("send", 0) + 1
        return True

    def _read(self) -> None:
        assert self._socket is not None
        for _ in range(_BATCH):
            try:
                datagram, address = self._socket.recvfrom(MOST_BYTES + 1)
            except BlockingIOError:
                return
            except OSError:
                # An ICMP error answers an earlier datagram.
                continue
            for data, to in self.outgoing(datagram, address):
                try:
                    self._socket.sendto(data, to)
                except OSError:
                    self.refused["send"] = self.refused.get("send", 0) + 1

    def outgoing(self, datagram: bytes, address: Address) -> list[tuple[bytes, Address]]:
        """Return the datagrams to send for one that arrived, with their destinations."""
        route = self.take(datagram, address)
        return [] if route is None else [route]

    def _ask(self, datagram: bytes, address: Address) -> bytes:
        request = parse_request(datagram)
        now_s = self._now_s()
        if not any(hmac.compare_digest(request.cookie, self._cookie(address, age)) for age in (0, 1)):
            if not self._cookies.take(1.0, now_s):
                raise RejectedError("cookies")
            return request.tag + COOKIE + self._cookie(address, 0)
        if not self._is_allowed(request.public):
            raise RejectedError("unlisted")
        keys = self._keys.get(request.public)
        if keys is None:
            keys = self._keys[request.public] = SharedKeys(self._own, request.public, TO_RELAY)
        fields = unpack(keys.open(request.sealed, request.context))
        try:
            peer, direct = bytes.fromhex(fields["peer"]), bool(fields["direct"])
        except (KeyError, TypeError, ValueError):
            raise RejectedError("malformed") from None
        place = Place((request.public, peer), address, request.tag, now_s, direct)
        other = None
        if peer:
            # The former place of this end, and the former end at this address, are removed.
            for old in (self.places.get(place.pair), self._by_address.get(address)):
                if old is not None:
                    self._remove(old)
            if sum(pair[0] == request.public for pair in self.places) >= _MOST_PLACES:
                raise RejectedError("places")
            self.places[place.pair] = self._by_address[address] = place
            other = self.places.get(place.pair[::-1])
        seen = other.address[:2] if other is not None and other.direct and direct else None
        tag = b"" if other is None else other.tag
        return answer_bytes(keys, request, {"you": address[:2], "peer": seen, "tag": tag.hex()})

    def _remove(self, place: Place) -> None:
        if self.places.get(place.pair) is place:
            del self.places[place.pair]
        if self._by_address.get(place.address) is place:
            del self._by_address[place.address]

    def _cookie(self, address: Address, age: int) -> bytes:
        """Return the cookie of an address for the present period or the one before; no cookie has to be stored."""
        text = f"{address[:2]} {int(self._now_s() / _COOKIE_S) - age}"
        return hmac.digest(self._secret, text.encode(), hashlib.sha256)[:COOKIE_BYTES]

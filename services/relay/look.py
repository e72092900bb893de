"""What a site can find out about its relay without joining anything: whether it is there, and lets this machine in."""

import asyncio
import os
import socket
from typing import Any

from services.relay.channel import HELLO_S, Gone, dial
from services.runtime.relay.path import TAG_BYTES
from services.runtime.relay.protocol import (
    ANSWER,
    COOKIE,
    COOKIE_BYTES,
    TO_RELAY,
    SharedKeys,
    make_request,
    raw_key,
    request_bytes,
    unpack,
)
from services.runtime.security.keyring import KeyPair

_ANSWER_S = 1.0
_ATTEMPTS = 4


def look_at_relay(host: str, port: int, own: KeyPair, relay_public: bytes) -> dict[str, Any]:
    """Return what the relay says to this machine over TCP: `name`, `present`, or `refused` and `text`.

    Raises:
        OSError, TimeoutError, RejectedError: It is not reached, or holds another key.
    """
    return asyncio.run(_look(host, port, own, relay_public))


async def _look(host: str, port: int, own: KeyPair, relay_public: bytes) -> dict[str, Any]:
    channel = await dial(host, port, own, relay_public, {"want": "look"})
    try:
        async with asyncio.timeout(HELLO_S):
            return await channel.receive()
    finally:
        channel.close()


def seen_by_relay(host: str, port: int, own: KeyPair, relay_public: bytes) -> tuple[str, int] | None:
    """Return the address at which the relay sees the datagrams of this machine; None where none come back."""
    keys, tag, cookie = SharedKeys(own, relay_public, TO_RELAY), os.urandom(TAG_BYTES), bytes(COOKIE_BYTES)
    family, _, _, _, relay = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    with socket.socket(family, socket.SOCK_DGRAM) as found:
        found.settimeout(_ANSWER_S)
        for _ in range(_ATTEMPTS):
            try:
                found.sendto(request_bytes(make_request(keys, tag, cookie, raw_key(own.public), b"")), relay)
                answer = found.recv(2048)
                kind, rest = answer[TAG_BYTES : TAG_BYTES + 1], answer[TAG_BYTES + 1 :]
                if answer[:TAG_BYTES] == tag and kind == COOKIE:
                    cookie = rest
                elif answer[:TAG_BYTES] == tag and kind == ANSWER:
                    host, port = unpack(keys.open(rest, tag + cookie))["you"]
                    return host, port
            except Gone:
                continue
    return None

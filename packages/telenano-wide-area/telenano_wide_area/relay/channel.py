"""A sealed connection between a site and its relay: the side that dials proves its key first.

The relay begins with a challenge. The side that dials sends its public key; after that each side sends frames: a length
of two bytes and a sealed body, bound to the challenge, the direction and the position of the frame, so that frames can
neither be replayed nor left out. If the relay joins two connections, the bytes of CURVE follow the last frame
unchanged.
"""

import asyncio
import contextlib
import os
import socket
import struct
from collections.abc import Callable
from typing import Any

from telenano.runtime import KeyPair
from telenano_wide_area.relay.protocol import (
    CHALLENGE_BYTES,
    MAGIC,
    PUBLIC_BYTES,
    TO_RELAY,
    SharedKeys,
    pack,
    raw_key,
    unpack,
)
from telenano_wide_area.sealed import RejectedError

# A client that has not proved its key after this time is disconnected [s].
HELLO_S = 5.0
# A connection without acknowledgements for this time is closed; the nodes close theirs sooner [ms].
_UNACKNOWLEDGED_MS = 10_000
_LENGTH = struct.Struct("!H")
_NUMBER = struct.Struct("!?Q")
_LARGEST_FRAME = 16_384
# Bytes in one of the frames into which longer ones are cut; nonce and tag are added.
_PIECE_BYTES = _LARGEST_FRAME - 64
CHUNK_BYTES = 65_536

# Exceptions that end a connection without being a fault of this program.
Gone = (OSError, EOFError, TimeoutError, RejectedError, ValueError)


class Channel:
    """One end of a connection, after the keys of both sides are known."""

    def __init__(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        keys: SharedKeys,
        challenge: bytes,
        *,
        is_relay: bool,
    ) -> None:
        self.reader, self.writer = reader, writer
        self._keys, self._challenge, self._is_relay = keys, challenge, is_relay
        self._sent = self._received = 0

    async def send(self, **fields: Any) -> None:
        """Send a frame."""
        await self._send(pack(fields))

    async def _send(self, body: bytes) -> None:
        sealed = self._keys.seal(body, self._challenge + _NUMBER.pack(self._is_relay, self._sent))
        self._sent += 1
        self.writer.write(_LENGTH.pack(len(sealed)) + sealed)
        await self.writer.drain()

    async def send_bytes(self, data: bytes) -> None:
        """Send bytes of any length, in sealed pieces."""
        for begin in range(0, len(data), _PIECE_BYTES) or (0,):
            more = begin + _PIECE_BYTES < len(data)
            await self._send(bytes((more,)) + data[begin : begin + _PIECE_BYTES])

    async def receive_bytes(self, most: int) -> bytes:
        """Return what `send_bytes` sent; RejectedError for more than `most` bytes, or what was not sent here."""
        data = bytearray()
        while True:
            body = await self._receive()
            data += body[1:]
            if len(data) > most:
                raise RejectedError("oversized")
            if body[:1] != b"\x01":
                return bytes(data)

    async def receive(self) -> dict[str, Any]:
        """Return the next frame; RejectedError for a frame that the other side did not send at this position."""
        return unpack(await self._receive())

    async def _receive(self) -> bytes:
        (length,) = _LENGTH.unpack(await self.reader.readexactly(_LENGTH.size))
        if length > _LARGEST_FRAME:
            raise RejectedError("oversized")
        sealed = await self.reader.readexactly(length)
        body = self._keys.open(sealed, self._challenge + _NUMBER.pack(not self._is_relay, self._received))
        self._received += 1
        return body

    def close(self) -> None:
        """Close the connection at once."""
        abort(self.writer)


def abort(writer: asyncio.StreamWriter) -> None:
    """Close a connection without waiting for unsent data."""
    transport: Any = writer.transport
    transport.abort()


def tend(writer: asyncio.StreamWriter) -> None:
    """Make the kernel find out when the other side of a connection is gone."""
    stream_socket = writer.get_extra_info("socket")
    with contextlib.suppress(OSError, AttributeError):
        stream_socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        stream_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 5)
        stream_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 2)
        stream_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNACKNOWLEDGED_MS)


async def dial(host: str, port: int, own: KeyPair, relay_public: bytes, request: dict[str, Any]) -> Channel:
    """Connect to a relay, prove this site's key and make a request; one of `Gone` if that fails."""
    async with asyncio.timeout(HELLO_S):
        reader, writer = await asyncio.open_connection(host, port, limit=CHUNK_BYTES)
        try:
            tend(writer)
            hello = await reader.readexactly(len(MAGIC) + CHALLENGE_BYTES)
            if hello[: len(MAGIC)] != MAGIC:
                raise RejectedError("no relay")
            keys = SharedKeys(own, relay_public, TO_RELAY)
            channel = Channel(reader, writer, keys, hello[len(MAGIC) :], is_relay=False)
            writer.write(raw_key(own.public))
            await channel.send(**request)
        except BaseException:
            abort(writer)
            raise
    return channel


async def meet(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, own: KeyPair, refuse: Callable[[bytes], None]
) -> tuple[bytes, Channel]:
    """Challenge a client that has connected; return the public key that it claims, and the channel.

    Receiving the first frame proves the key. `refuse` raises RejectedError for a key whose proof is not worth checking.
    """
    challenge = os.urandom(CHALLENGE_BYTES)
    writer.write(MAGIC + challenge)
    public = await reader.readexactly(PUBLIC_BYTES)
    refuse(public)
    return public, Channel(reader, writer, SharedKeys(own, public, TO_RELAY), challenge, is_relay=True)


async def splice(
    one: tuple[asyncio.StreamReader, asyncio.StreamWriter],
    other: tuple[asyncio.StreamReader, asyncio.StreamWriter],
    budget: "Budget | None" = None,
) -> None:
    """Carry bytes between two connections in both directions until one of them ends; then close both."""
    ways = [asyncio.create_task(_carry(*pair, budget)) for pair in ((one[0], other[1]), (other[0], one[1]))]
    try:
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for way in ways:
            way.cancel()
        await asyncio.gather(*ways, return_exceptions=True)
        for _, writer in (one, other):
            abort(writer)


async def _carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, budget: "Budget | None") -> None:
    with contextlib.suppress(*Gone):
        while data := await reader.read(CHUNK_BYTES):
            if budget is not None:
                await budget.wait_for(len(data))
            writer.write(data)
            await writer.drain()


class Budget:
    """A token bucket: `per_s` tokens a second, and at most `burst` at once."""

    def __init__(self, per_s: float, burst: float, now_s: float) -> None:
        self._per_s, self._burst = per_s, burst
        self._left, self._at_s = burst, now_s

    def take(self, amount: float, now_s: float) -> bool:
        """Take an amount if it is available; return whether it was."""
        self._refill(now_s)
        if self._left < amount:
            return False
        self._left -= amount
        return True

    async def wait_for(self, amount: float) -> None:
        """Take an amount, and wait until it would have been available."""
        self._refill(asyncio.get_running_loop().time())
        self._left -= amount
        if self._left < 0.0:
            await asyncio.sleep(-self._left / self._per_s)

    def _refill(self, now_s: float) -> None:
        self._left = min(self._burst, self._left + (now_s - self._at_s) * self._per_s)
        self._at_s = now_s

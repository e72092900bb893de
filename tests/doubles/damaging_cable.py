"""A TCP forwarder that alters, cuts, delays and repeats data in handshakes and streams, and floods, from a seed.

    with DamagingCable({port: target_port}, seed=1) as cable: ...

It stands between two ends of ZeroMQ on this machine: a connection to one of its ports is forwarded to the target.
Altered data arrive with a right TCP checksum, as from a machine on the path. `cable.done` counts its actions.
"""

import asyncio
import contextlib
import random
import socket
import struct
from collections import Counter
from collections.abc import Mapping

from loop_thread import LoopThread

# Greeting, handshake and first messages of a connection are within this number of bytes of a direction.
_HANDSHAKE_BYTES = 700
# Greatest distance of a later alteration from the previous one [bytes], a second of a stream.
_STREAM_BYTES = 60_000
# Longest time after which a connection is cut [s].
_LONGEST_S = 3.0
_GREETING = bytes((0xFF, 0, 0, 0, 0, 0, 0, 0, 1, 0x7F, 3, 1))
_MECHANISMS = (b"CURVE", b"NULL", b"PLAIN", b"GSSAPI", bytes(20))
_COMMANDS = (
    b"\x05HELLO",
    b"\x07WELCOME",
    b"\x08INITIATE",
    b"\x05READY",
    b"\x05ERROR",
    b"\x07MESSAGE",
    b"\x04PING",
    b"",
)


class DamagingCable(LoopThread):
    """Forwards connections from some ports to others, and damages them, while the block runs."""

    def __init__(self, targets: Mapping[int, int], seed: int, *, early: float = 0.2, flood_per_s: float = 20.0) -> None:
        """Prepare to forward.

        Args:
            targets: The target port for each listening port.
            seed: The seed of all random draws.
            early: The share of the directions that are altered in their handshake.
            flood_per_s: The rate of additional connections with garbage to each target [1/s].
        """
        super().__init__()
        self.done: Counter[str] = Counter()
        self._targets, self._draw = dict(targets), random.Random(seed)
        self._early, self._flood_per_s = early, flood_per_s
        self._floods: list[asyncio.Task[None]] = []
        self._open: list[asyncio.StreamWriter] = []

    async def begin(self) -> None:
        """Listen at the ports, and start the floods."""
        self.servers += [
            await asyncio.start_server(lambda near, out, port=target: self._join(near, out, port), "127.0.0.1", port)
            for port, target in self._targets.items()
        ]
        if self._flood_per_s:
            self._floods = [self.loop.create_task(self._flood(target)) for target in self._targets.values()]

    async def ended(self) -> None:
        """Abort every connection."""
        for writer in self._open:
            writer.transport.abort()
        # Aborted connections are closed in the next round of the event loop.
        await asyncio.sleep(0.05)

    async def _join(self, near: asyncio.StreamReader, to_near: asyncio.StreamWriter, target: int) -> None:
        self.done["connections"] += 1
        self._open.append(to_near)
        try:
            far, to_far = await asyncio.open_connection("127.0.0.1", target)
        except OSError:
            to_near.close()
            return
        self._open.append(to_far)
        until_s = self.loop.time() + self._draw.uniform(0.1, 1.0) * self._draw.choice((0.1, 1.0)) * _LONGEST_S
        ways = self._carry(near, to_far, until_s), self._carry(far, to_near, until_s)
        with contextlib.suppress(OSError, TimeoutError):
            await asyncio.gather(*ways)
        for writer in (to_near, to_far):
            if self._draw.random() < 0.5:
                # End it by a reset, with pending data unsent.
                end = writer.get_extra_info("socket")
                with contextlib.suppress(OSError):
                    end.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                self.done["resets"] += 1
            writer.close()

    async def _carry(self, source: asyncio.StreamReader, target: asyncio.StreamWriter, until_s: float) -> None:
        draw, passed = self._draw, 0
        next_at = draw.randrange(_HANDSHAKE_BYTES if draw.random() < self._early else _STREAM_BYTES)
        while (left_s := until_s - self.loop.time()) > 0:
            piece = await asyncio.wait_for(source.read(draw.choice((7, 64, 4096))), left_s)
            if not piece:
                return
            if passed <= next_at < passed + len(piece):
                piece = self._altered(
                    piece, next_at - passed, "handshakes" if next_at < _HANDSHAKE_BYTES else "streams"
                )
                next_at += draw.randrange(_STREAM_BYTES)
            passed += len(piece)
            if draw.random() < 0.01:
                self.done["delays"] += 1
                await asyncio.sleep(draw.uniform(0.0, 0.3))
            target.write(piece)
            await target.drain()

    def _altered(self, piece: bytes, at: int, where: str) -> bytes:
        draw = self._draw
        kind = draw.choice(("flips", "flips", "flips", "cuts", "repeats", "insertions"))
        self.done[f"{kind} in {where}"] += 1
        if kind == "flips":
            return piece[:at] + bytes((piece[at] ^ 1 << draw.randrange(8),)) + piece[at + 1 :]
        if kind == "cuts":
            return piece[:at]
        if kind == "repeats":
            return piece[:at] + piece
        return piece[:at] + draw.randbytes(draw.choice((1, 9, 300))) + piece[at:]

    async def _flood(self, target: int) -> None:
        """Connect to a target repeatedly, and send data that begin like a ZeroMQ peer's and continue with garbage."""
        draw = self._draw
        while True:
            await asyncio.sleep(draw.expovariate(self._flood_per_s))
            with contextlib.suppress(OSError):
                _, writer = await asyncio.open_connection("127.0.0.1", target)
                self._open.append(writer)
                self.done["floods"] += 1
                greeting = (
                    _GREETING + draw.choice(_MECHANISMS).ljust(20, b"\0") + bytes((draw.randrange(2),)) + bytes(31)
                )
                name = draw.choice(_COMMANDS)
                body = name + draw.randbytes(draw.choice((0, 10, 194, 250)))
                frame = bytes((draw.choice((4, 0, 1, 2, 6, 255)), min(255, len(body)))) + body
                text = draw.choice((greeting, greeting[: draw.randrange(64)], b"GET / HTTP/1.1\r\n\r\n", b""))
                writer.write(text + draw.choice((frame, frame * 50, b"")))
                await asyncio.sleep(draw.uniform(0.0, 0.05))
                if draw.random() < 0.7:
                    writer.close()

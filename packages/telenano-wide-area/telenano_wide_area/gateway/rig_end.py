"""The end of a rig at its gateway: it dials out, and joins each page there with the server of the page here.

The server of the page sees a page of this machine: it asks for the token, and decides what its role may.
"""

import asyncio
import contextlib
import socket
import time
from typing import Any

from telenano.runtime import AccessControl, StructuredLog
from telenano_wide_area.gateway.datagrams import FELT, HAND, NUMBER_BYTES, PROBE, PageDatagrams, is_of
from telenano_wide_area.relay.channel import Channel, Gone
from telenano_wide_area.relay.path import Address, RelayPath
from telenano_wide_area.relay.protocol import TO_RELAY, SharedKeys, raw_key
from telenano_wide_area.relay.relay_client import RelayClient
from telenano_wide_area.sealed import RejectedError

# The largest frame of a page [bytes]; the server of the page limits it too.
_MOST_BYTES = 1 << 16
# The server of the page answers a connection within this time [s].
_SERVER_S = 3.0
# What is felt goes by a datagram to a page of which one has come within this time [s].
_HEARD_S = 0.5
# The interval at which the place for datagrams is kept [s].
_MAINTAIN_S = 0.1


class _Page:
    """A page: its socket at the server of the page, and when its last datagram came, on the monotonic clock [s]."""

    def __init__(self, number: bytes, opened: Any) -> None:
        self.number, self.socket = number, opened
        self.heard_s = 0.0


class RigEnd(RelayClient, asyncio.DatagramProtocol):
    """The end of one rig.

    Args:
        gateway: `HOST:PORT` of the relay in the gateway.
        page_port: The port of the server of the page on this machine.
        access: The keys of the rig's machine.
        log: Logs that the gateway is reached or lost.

    Raises:
        ConfigError: The key of the gateway is not listed with the role relay.
        ValueError: `gateway` is not of the form HOST:PORT.
    """

    def __init__(self, gateway: str, page_port: int, access: AccessControl, log: StructuredLog) -> None:
        super().__init__(gateway, access, log)
        self._page = f"127.0.0.1:{page_port}"
        self._pages: dict[bytes, _Page] = {}
        self._sealing = PageDatagrams(self._own, self._relay_key, is_gateway=False)
        self._transport: asyncio.DatagramTransport | None = None
        self._path: RelayPath | None = None
        self._heard_ns = 0

    async def run(self) -> None:
        """Keep the connection to the gateway, until cancelled."""
        try:
            self._start(self._reload())
            self._start(self._maintain())
            await self._keep_connected()
        finally:
            self._end()
            if self._transport is not None:
                self._transport.close()

    def _meets(self) -> set[str]:
        return set()

    async def _see(self, present: frozenset[str]) -> None:
        """Do nothing: a gateway tells of no other machine."""

    async def _accept(self, control: Channel, message: dict[str, Any]) -> None:
        """Join a page at the gateway with the server of the page here."""
        from websockets.asyncio.client import connect
        from websockets.exceptions import WebSocketException

        number = str(message.get("open"))
        if message.get("source") != self._relay_key.hex():
            await control.send(refused=number)
            return
        try:
            origin: Any = f"http://{self._page}"
            async with connect(
                f"ws://{self._page}/bus", origin=origin, compression=None, max_size=None, open_timeout=_SERVER_S
            ) as joined:
                channel = await self._dial(want="accept", number=number)
                try:
                    if "ok" in await channel.receive():
                        await self._join(channel, _Page(bytes.fromhex(number), joined))
                finally:
                    channel.close()
        except (*Gone, WebSocketException) as error:
            self._tell("warning", f"a page was not joined with the server at {self._page}: {error}", "page")
            with contextlib.suppress(*Gone):
                await control.send(refused=number)

    async def _join(self, channel: Channel, page: _Page) -> None:
        """Carry the frames of a page both ways until one of its connections ends."""
        self._pages[page.number] = page
        ways = [asyncio.create_task(way) for way in (self._from_page(channel, page), self._to_page(channel, page))]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            del self._pages[page.number]
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)

    async def _from_page(self, channel: Channel, page: _Page) -> None:
        while True:
            await page.socket.send(await channel.receive_bytes(_MOST_BYTES))

    async def _to_page(self, channel: Channel, page: _Page) -> None:
        async for frame in page.socket:
            is_heard = time.monotonic() - page.heard_s < _HEARD_S
            if not (is_heard and is_of(frame, FELT) and self._send(page, frame)):
                await channel.send_bytes(frame)

    # --- datagrams ---

    def _send(self, page: _Page, frame: bytes) -> bool:
        if self._transport is None or self._path is None or self._path.peer is None:
            return False
        self._transport.sendto(self._sealing.seal(page.number, frame), self._path.peer)
        return True

    async def _maintain(self) -> None:
        """Keep a socket and the place at the gateway; a machine without UDP goes on by streams alone."""
        loop = asyncio.get_running_loop()
        while True:
            with contextlib.suppress(OSError):
                if self._transport is None or self._transport.is_closing():
                    found = await loop.getaddrinfo(self._host, self._port, type=socket.SOCK_DGRAM)
                    family, _, _, _, address = found[0]
                    self._transport, _ = await loop.create_datagram_endpoint(lambda: self, family=family)
                    keys = SharedKeys(self._own, self._relay_key, TO_RELAY)
                    own = raw_key(self._own.public)
                    self._path = RelayPath(address, keys, keys, own, self._relay_key, direct=False)
                    self._path.send = self._transport.sendto
            if self._path is not None:
                now_ns = time.monotonic_ns()
                self._path.maintain(now_ns, now_ns - self._heard_ns)
            await asyncio.sleep(_MAINTAIN_S)

    def datagram_received(self, data: bytes, addr: Address) -> None:
        """Take a datagram of the gateway: an answer of its relay, the force of a hand, or a probe, which goes back."""
        path = self._path
        if path is None:
            return
        with contextlib.suppress(RejectedError):
            if data.startswith(path.tag) and len(data) > NUMBER_BYTES:
                path.take(data, addr)
                return
            number, frame = self._sealing.open(data)
            self._heard_ns = time.monotonic_ns()
            page = self._pages.get(number)
            if page is None or not is_of(frame, HAND, PROBE):
                return
            page.heard_s = time.monotonic()
            if is_of(frame, PROBE):
                self._send(page, frame)
            else:
                self._start(self._give(page, frame))

    async def _give(self, page: _Page, frame: bytes) -> None:
        from websockets.exceptions import WebSocketException

        with contextlib.suppress(*Gone, WebSocketException):
            await page.socket.send(frame)

    def error_received(self, exc: Exception) -> None:
        """Do nothing: an ICMP error answers an earlier datagram."""

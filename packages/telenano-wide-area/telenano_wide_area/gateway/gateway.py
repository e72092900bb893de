"""The gateway of a laboratory: it serves the page to browsers, and joins each with the rig that has dialled out to it.

The frames of a page cross as they are, between its socket here and the sealed connection that its rig has dialled. The
rig asks for the token. A page that its rig has admitted is given a ticket for a session of WebTransport, by which the
force of its hand and what is felt cross as datagrams.
"""

import asyncio
import contextlib
import secrets
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import msgpack
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from telenano.serving import Access, Connections, client_of, guarded
from telenano_wide_area.gateway.datagrams import FELT, HAND, PROBE, PageDatagrams, is_of
from telenano_wide_area.relay.channel import Channel, Gone
from telenano_wide_area.relay.protocol import raw_key
from telenano_wide_area.relay.server import Relay
from telenano_wide_area.sealed import RejectedError

# The largest frame to a page [bytes]: a snapshot with the lines of an image.
_MOST_BYTES = 1 << 27
# Close codes of RFC 6455.
_TRY_LATER = 1013
_TICKET_BYTES = 18
_SNAPSHOT = b"\xa1k\xa8snapshot"

Send = Callable[[bytes], None]


class GatewayPage:
    """A page: the number of its connection to its rig, and what sends a datagram to it, None without datagrams."""

    def __init__(self, rig: bytes, number: bytes) -> None:
        self.rig, self.number = rig, number
        self.send: Send | None = None


class Gateway:
    """The pages of a gateway.

    Args:
        relay: The relay to which the rigs dial out.
        certificate_hash: SHA-256 of a certificate that no authority vouches for, which pages then accept for their
            datagrams; empty for another one.
    """

    def __init__(self, relay: Relay, certificate_hash: bytes = b"") -> None:
        self._relay, self._hash = relay, certificate_hash
        self._pages: dict[bytes, GatewayPage] = {}
        self._tickets: dict[str, GatewayPage] = {}
        self._sealing: dict[bytes, PageDatagrams] = {}
        # Datagrams to rigs and to pages, and those left out.
        self.carried = {"hand": 0, "felt": 0, "refused": 0}
        relay.forwarder.deliver = self._from_rig

    def app(self, page: Path, access: Access, connections: Connections) -> Any:
        """Return the web application: the page of a folder for each rig, by its name at the relay, and its socket."""

        @contextlib.asynccontextmanager
        async def lifespan(app: Starlette) -> AsyncIterator[None]:
            sweeping = asyncio.create_task(connections.sweep())
            try:
                yield
            finally:
                sweeping.cancel()

        async def serve(socket: WebSocket) -> None:
            await socket.accept()
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                await self._serve(socket, lambda: connections.admit(client_of(socket.scope)))

        async def health(request: Request) -> Response:
            return PlainTextResponse("ok\n")

        async def with_slash(request: Request) -> Response:
            return RedirectResponse(f"/{request.path_params['rig']}/")

        routes = [
            Route("/health", health),
            Route("/{rig}", with_slash),
            WebSocketRoute("/{rig}/bus", serve),
            Mount("/{rig}", StaticFiles(directory=page, html=True)),
        ]
        return guarded(Starlette(routes=routes, lifespan=lifespan), access, connections)

    # --- frames ---

    async def _serve(self, socket: WebSocket, admit: Callable[[], None]) -> None:
        name = socket.path_params["rig"]
        rig = next((site.key for site in self._relay.sites.values() if site.name == name), "")
        try:
            async with self._relay.dialled(rig, raw_key(self._relay.own.public).hex(), 0) as (number, channel):
                page = GatewayPage(bytes.fromhex(rig), bytes.fromhex(number))
                await self._join(socket, channel, page, admit)
            await socket.close()
        except (*Gone, RejectedError):
            text = f"the rig {name[:64]!r} is not at this gateway, or serves no page"
            await socket.send_bytes(msgpack.packb({"k": "refused", "text": text}))
            await socket.close(_TRY_LATER)

    async def _join(self, socket: WebSocket, channel: Channel, page: GatewayPage, admit: Callable[[], None]) -> None:
        """Carry the frames of a page both ways until one of its connections ends."""
        ticket = secrets.token_urlsafe(_TICKET_BYTES)

        async def from_page() -> None:
            while True:
                await channel.send_bytes(await socket.receive_bytes())

        async def to_page() -> None:
            while True:
                frame = await channel.receive_bytes(_MOST_BYTES)
                await socket.send_bytes(frame)
                if page.number not in self._pages and _SNAPSHOT in frame[:16]:
                    # The rig has admitted the page.
                    admit()
                    self._pages[page.number] = self._tickets[ticket] = page
                    offer = {"k": "datagrams", "path": f"way/{ticket}", "hash": self._hash}
                    await socket.send_bytes(msgpack.packb(offer))

        ways = [asyncio.create_task(way) for way in (from_page(), to_page())]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._pages.pop(page.number, None)
            self._tickets.pop(ticket, None)
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)

    # --- datagrams ---

    def open_way(self, path: str, send: Send) -> GatewayPage | None:
        """Return the page whose ticket is in the path of a session, which gets its datagrams by `send` from now on."""
        ticket = path.rpartition("/way/")[2]
        page = self._tickets.pop(ticket, None)
        if page is not None:
            page.send = send
        return page

    def from_page(self, page: GatewayPage, frame: bytes) -> None:
        """Send the force of a page's hand, or its probe, to its rig; leave out anything else."""
        is_carried = self._pages.get(page.number) is page and is_of(frame, HAND, PROBE)
        if is_carried:
            datagram = self._sealing_of(page.rig).seal(page.number, frame)
            is_carried = self._relay.forwarder.send(page.rig, datagram)
        self.carried["hand" if is_carried else "refused"] += 1

    def _from_rig(self, rig: bytes, datagram: bytes) -> None:
        """Send what is felt, or a probe that comes back, to its page."""
        try:
            number, frame = self._sealing_of(rig).open(datagram)
        except RejectedError:
            self.carried["refused"] += 1
            return
        page = self._pages.get(number)
        is_carried = page is not None and page.rig == rig and page.send is not None and is_of(frame, FELT, PROBE)
        if is_carried and page is not None and page.send is not None:
            page.send(frame)
        self.carried["felt" if is_carried else "refused"] += 1

    def _sealing_of(self, rig: bytes) -> PageDatagrams:
        if rig not in self._sealing:
            self._sealing[rig] = PageDatagrams(self._relay.own, rig, is_gateway=True)
        return self._sealing[rig]

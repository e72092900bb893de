"""A web socket for other programs, served in a thread of its own, with the page's access rules and a token.

async def serve(socket):                       # a Starlette WebSocket that is accepted
    await socket.send_text("hello")

with contextlib.closing(TokenSocket(ViewConfig(port=0), serve, ["my.protocol.v1"])) as server:
    server.address                             # ws://127.0.0.1:43215/?token=...
    server.call(function, value)               # from any thread: the thread of the server runs function(value)

Addresses, host names, origins and the number of connections are limited as for the page. The token is in the query of
the address, because programs have no other place for it.
"""

import asyncio
import contextlib
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from typing import Any

from starlette.applications import Starlette
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from telenano.serving.access import Access
from telenano.serving.config import ViewConfig
from telenano.serving.connections import Connections, most_connections
from telenano.serving.gate import POLICY, client_of, guarded
from telenano.serving.serve import announced, bind, make_server

_LEAST_STRANGERS = 8
_WRONG_TOKEN_S = 0.5
_START_S = 0.005


class TokenSocket:
    """A web socket at an address, which serves until it is closed.

    Args:
        config: Address and access of the server.
        serve: Coroutine that serves one connection until it returns or the connection ends.
        protocols: The subprotocols of which a client must offer one.
        what: The name of the server in messages.
        token: The token of the clients; empty to generate one.
        origins: The origins of pages that may connect. Programs send no origin and need only the token.
        most: Most simultaneous connections.

    Raises:
        ConfigError: A file of the certificate is missing, or a token or an address cannot be used.
        EndpointError: The address cannot be bound.
    """

    def __init__(
        self,
        config: ViewConfig,
        serve: Callable[[WebSocket], Awaitable[None]],
        protocols: Sequence[str],
        *,
        what: str = "the server",
        token: str = "",
        origins: Sequence[str] = (),
        most: int = 16,
    ) -> None:
        self._serve, self._protocols, self._what, self._most = serve, protocols, what, most
        tls = config.tls()
        names = [config.host, *config.names]
        self._access = Access.made(observer=token, names=names, allow=config.allow, origins=["", *origins])
        self._connected = 0
        self._loop: asyncio.AbstractEventLoop | None = None
        self._connections = Connections(most_connections(most + _LEAST_STRANGERS))
        routes = [WebSocketRoute("/", self._admit)]
        app = guarded(Starlette(routes=routes, lifespan=self._lifespan), self._access, self._connections)
        self._server = make_server(app, tls)
        with bind(config.host, config.port, what) as bound:
            self.port = int(bound.getsockname()[1])
            listener = bound.again(self._connections)
        shown = config.name or (f"[{config.host}]" if ":" in config.host else config.host)
        self.address = f"{'wss' if tls else 'ws'}://{shown}:{self.port}/?token={self._access.observer_token}"
        self._thread = threading.Thread(target=self._server.run, kwargs={"sockets": [listener]}, name=what)
        self._thread.start()
        while not self._server.started and self._thread.is_alive():
            time.sleep(_START_S)

    def call(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call a function in the thread of the server; do nothing if the server is not running."""
        loop = self._loop
        with contextlib.suppress(RuntimeError):
            if loop is not None:
                loop.call_soon_threadsafe(function, *arguments)

    def announced(self, called: str, show: Callable[[str], None], what: str) -> contextlib.AbstractContextManager[None]:
        """Keep the address in a private file while a block runs, and show it on a terminal.

        Args:
            called: The label of the address, such as `open in a viewer`.
            show: Function that prints a line.
            what: The name of the server, with which that of the file begins.
        """
        return announced({called: self.address}, show, what)

    def close(self) -> None:
        """End the server and its connections."""
        self._server.should_exit = True
        self._thread.join()

    @contextlib.asynccontextmanager
    async def _lifespan(self, app: Any) -> AsyncIterator[None]:
        self._loop = asyncio.get_running_loop()
        sweeping = asyncio.create_task(self._connections.sweep())
        try:
            yield
        finally:
            self._loop = None
            sweeping.cancel()
            await asyncio.gather(sweeping, return_exceptions=True)

    async def _admit(self, socket: WebSocket) -> None:
        fault = await self._fault(socket)
        if fault:
            # Close it before accepting, so that the client reports a refusal.
            await socket.close(POLICY, fault)
            return
        self._connections.admit(client_of(socket.scope))
        self._connected += 1
        try:
            await socket.accept(subprotocol=self._chosen(socket))
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                await self._serve(socket)
        finally:
            self._connected -= 1

    async def _fault(self, socket: WebSocket) -> str:
        """Return the reason why a connection is refused; empty if it is admitted."""
        if self._access.role_of(socket.query_params.get("token", "")) is None:
            await asyncio.sleep(_WRONG_TOKEN_S)
            return f"the token is missing or wrong: open the address that {self._what} printed"
        if self._connected >= self._most:
            return f"{self._connected} are connected, which is as many as may be"
        if not self._chosen(socket):
            return f"{self._what} speaks one of {', '.join(self._protocols)}"
        return ""

    def _chosen(self, socket: WebSocket) -> str | None:
        return next((name for name in self._protocols if name in socket.scope["subprotocols"]), None)

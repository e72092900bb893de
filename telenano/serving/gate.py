"""The gate of a web server: it checks addresses, host names and origins, and keeps account of connections."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from starlette.responses import PlainTextResponse
from starlette.websockets import WebSocketDisconnect

from telenano.serving.access import Access
from telenano.serving.connections import Connections

# Close code of RFC 6455.
POLICY = 1008
# Libraries set the styles of elements through the DOM, so style-src needs no exception.
_HEADERS = (
    (
        b"content-security-policy",
        b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
        b"font-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"permissions-policy", b"camera=(), microphone=(), geolocation=(), xr-spatial-tracking=(self), gamepad=(self)"),
    (b"cache-control", b"no-cache"),
)

_CLIENT = "telenano.client"

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]


class _Accounted:
    """Records the connection of each request by its real remote address, before headers can change it."""

    def __init__(self, app: Any, connections: Connections) -> None:
        self._app = app
        self._connections = connections

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        client = scope.get("client")
        scope[_CLIENT] = tuple(client or ())
        self._connections.begin(scope[_CLIENT])
        try:
            await self._app(scope, receive, send)
        finally:
            self._connections.end(scope[_CLIENT])


class _Gate:
    """Refuses addresses, host names and origins that are not admitted, and adds security headers to responses."""

    def __init__(self, app: Any, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        fault = self._fault(scope)
        if fault and scope["type"] == "http":
            await PlainTextResponse(f"telenano: {fault}\n", 403)(scope, receive, send)
        elif fault:
            await receive()
            await send({"type": "websocket.close", "code": POLICY, "reason": fault})
        else:
            await self._app(scope, receive, lambda message: send(_with_headers(message)))

    def _fault(self, scope: Scope) -> str:
        client = scope.get("client")
        address = client[0] if client else ""
        if not self._access.admits_address(address):
            return f"connections from {address or 'an unknown address'} are not allowed: start the server with --allow"
        headers = dict(scope["headers"])
        host = headers.get(b"host", b"").decode("latin-1")
        if not self._access.admits_host(host):
            return f"{host!r} is not a name of this server: use one of {', '.join(self._access.hosts)}"
        origin = headers.get(b"origin", b"").decode("latin-1")
        encrypted = scope.get("scheme") in ("https", "wss")
        if scope["type"] == "websocket" and not self._access.admits_origin(origin, host, encrypted=encrypted):
            others = ", or name its origin with --allow-origin" if self._access.origins else ""
            return f"a page from {origin!r} may not connect: open the address that was printed{others}"
        return ""


def guarded(app: Any, access: Access, connections: Connections) -> Any:
    """Return an application behind the gate, with account of its connections.

    A proxy on this machine may give the origin of a request in `X-Forwarded-For` and its scheme in `X-Forwarded-Proto`,
    as is usual for web servers.
    """
    from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

    gate: Any = _Gate(app, access)
    return _Accounted(ProxyHeadersMiddleware(gate), connections)


def client_of(scope: Scope) -> Any:
    """Return the key of a request's connection in `Connections`."""
    return scope.get(_CLIENT)


def _with_headers(message: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    if message["type"] == "http.response.start":
        message["headers"] = [*message.get("headers", ()), *_HEADERS]
    return message


async def end_quietly(sender: "asyncio.Task[None]") -> None:
    """Cancel a task that sends to a socket, which may be closed already, and wait for its end."""
    sender.cancel()
    with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
        await sender

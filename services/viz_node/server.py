"""The web server of the page: static files, and one web socket per page. The browser has no access to the bus."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator
from functools import partial
from pathlib import Path
from typing import Any

import msgpack
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse, Response
from starlette.routing import BaseRoute, Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from services.viz_node.hub import REVOKED, Hub
from services.viz_node.metrics import MEDIA_TYPE
from services.viz_node.page_session import Session
from services.viz_node.page_threads import in_thread
from services.viz_node.recording_files import MOST_DOWNLOADS, Download, open_recording
from services.viz_node.requests import PROTOCOL, Hello, RequestError, read_request
from telenano.serving.access import Access, Role, is_loopback
from telenano.serving.connections import SILENCE_S, Connections
from telenano.serving.gate import POLICY, client_of, end_quietly, guarded
from telenano.serving.people import Person
from telenano.timing.clock import SystemClock
from telenano.wire.errors import RefusedError

_HELLO_S = SILENCE_S
# Delay of the answer to a wrong token, which limits the rate of guesses, one per connection [s].
_WRONG_TOKEN_S = 0.5
# Close codes of RFC 6455.
_TRY_LATER = 1013
_UNSUPPORTED = 1003


class _PageSocket:
    """Serves the web socket of a page, from its first frame to its last."""

    def __init__(self, hub: Hub, access: Access, connections: Connections) -> None:
        self._hub = hub
        self._access = access
        self._connections = connections
        # Tasks are stored until they end, even after their page has left, so that they are not collected.
        self._tasks: set[asyncio.Task[None]] = set()

    async def serve(self, socket: WebSocket) -> None:
        await socket.accept()
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            shown = await self._role(socket)
            if shown is not None:
                self._connections.admit(client_of(socket.scope))
                await self._converse(socket, *shown)

    async def _role(self, socket: WebSocket) -> tuple[Role, Person | None] | None:
        """Return the role and the person of a page that sends a valid token; None after a refusal."""
        try:
            request = read_request(await asyncio.wait_for(_receive(socket), _HELLO_S))
            if not isinstance(request, Hello):
                raise RequestError("the first frame must be hello, with the token")
            if request.protocol != PROTOCOL:
                text = (
                    f"this page speaks version {request.protocol}, the server version {PROTOCOL}: load the page again"
                )
                await _refuse(socket, POLICY, text)
                return None
            role = self._access.role_of(request.token)
            person = self._access.person_of(request.token)
            if role is None and person is not None:
                self._hub.desk.refused.note("revoked", f"{person.name}: the address was revoked, or has expired")
                await _refuse(socket, POLICY, REVOKED)
            elif role is None:
                self._hub.desk.refused.note("token", "a page showed a token that belongs to no person")
                await asyncio.sleep(_WRONG_TOKEN_S)
                await _refuse(
                    socket,
                    POLICY,
                    "the token is wrong: open the address that telenano view --addresses prints where the rig runs",
                )
            elif reason := self._hub.make_room(role):
                await _refuse(socket, _TRY_LATER, reason)
            else:
                return role, person
            return None
        except TimeoutError:
            await _refuse(socket, POLICY, f"no token came within {_HELLO_S:g} s")
        except RequestError as error:
            await _refuse(socket, _UNSUPPORTED, str(error))
        return None

    async def _converse(self, socket: WebSocket, role: Role, person: Person | None) -> None:
        session = self._hub.join(role, person)
        # The page was told to end, but its client reads nothing.
        session.drop = lambda: self._connections.drop(client_of(socket.scope))
        sender = asyncio.create_task(_send_all(socket, session))
        try:
            while True:
                frame = await _receive(socket)
                arrived_s = time.monotonic()
                # A task for each request, so that an emergency stop does not wait for an earlier command.
                task = asyncio.create_task(self._hub.handle(session, read_request(frame), arrived_s))
                self._tasks.add(task)
                task.add_done_callback(self._tasks.discard)
        except RequestError as error:
            await _refuse(socket, _UNSUPPORTED, str(error))
        finally:
            self._hub.leave(session)
            await end_quietly(sender)


class _Downloads:
    """Sends the file of the recording for which an address was given."""

    def __init__(self, hub: Hub, connections: Connections) -> None:
        self._hub = hub
        self._connections = connections
        self._running = 0

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        if scope["method"] != "GET":
            await PlainTextResponse("telenano: a recording is fetched with GET\n", 405)(scope, receive, send)
        elif self._running >= MOST_DOWNLOADS:
            text = f"telenano: {self._running} recordings are being downloaded already: press the file again later\n"
            await PlainTextResponse(text, 503)(scope, receive, send)
        else:
            self._running += 1
            try:
                await (await self._response(scope))(scope, receive, send)
            finally:
                self._running -= 1

    async def _response(self, scope: Any) -> Download | Response:
        hub, client = self._hub, client_of(scope)
        found = hub.recording.redeem(scope["path_params"]["ticket"], lambda session: session in hub.sessions)
        if found is None:
            text = "telenano: this address is not valid, or no longer: press the file on the page again\n"
            return PlainTextResponse(text, 404)
        path, session = found
        try:
            opened = await asyncio.wrap_future(in_thread(partial(open_recording, path)))
        except RefusedError as error:
            return PlainTextResponse(f"telenano: {error}\n", 404)
        # An address is as good as a token, so the connection is not dropped for a new one.
        self._connections.admit(client)
        return Download(
            opened, opened.name(path), lambda: hub.may_have(session), lambda: self._connections.drop(client)
        )


async def _receive(socket: WebSocket) -> bytes:
    """Return the bytes of the next frame; raise RequestError for a text frame."""
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1000))
    data = message.get("bytes")
    if data is None:
        raise RequestError("a frame is text: the page sends msgpack in binary frames")
    return bytes(data)


async def _send_all(socket: WebSocket, session: Session) -> None:
    while not session.is_over:
        await socket.send_bytes(await session.next_frame())
    await socket.close(POLICY)


async def _refuse(socket: WebSocket, code: int, text: str) -> None:
    """Send the reason as a frame, because a page cannot read the reason of every close, and close the socket."""
    await socket.send_bytes(msgpack.packb({"k": "refused", "text": text}))
    await socket.close(code, text.encode()[:120].decode(errors="ignore"))


def make_app(hub: Hub, access: Access, page: Path | None, connections: Connections | None = None) -> Any:
    """Return the web application: the page of a folder, its web socket at /bus, /health and /metrics.

    Args:
        hub: The hub of the open pages.
        access: The tokens and their roles.
        page: The folder of the built page; if None, the server answers with the command that builds it.
        connections: The connections of the listener that serves it.
    """
    connections = connections or Connections()
    hub.is_admitted = access.people.is_admitted
    clock = SystemClock()

    @contextlib.asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        tasks = asyncio.create_task(hub.run()), asyncio.create_task(connections.sweep())
        tasks[0].add_done_callback(hub.note_end)
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            # `Hub.note_end` has stored the error that ended them.
            await asyncio.gather(*tasks, return_exceptions=True)

    async def health(request: Request) -> PlainTextResponse:
        return PlainTextResponse("ok\n")

    async def metrics(request: Request) -> PlainTextResponse:
        host = request.client.host if request.client else ""
        # A monitoring system on this machine needs no token; one on another machine sends it in a header.
        if not is_loopback(host):
            token = request.headers.get("authorization", "").removeprefix("Bearer ")
            if access.role_of(token) in (None, Role.PARTICIPANT):
                await asyncio.sleep(_WRONG_TOKEN_S)
                text = "from another machine /metrics needs the token of an observer: Authorization: Bearer TOKEN"
                return PlainTextResponse(f"telenano: {text}\n", 401, {"www-authenticate": "Bearer"})
        return PlainTextResponse(hub.metrics(clock.now_ns()), media_type=MEDIA_TYPE)

    async def missing(request: Request) -> PlainTextResponse:
        return PlainTextResponse("telenano: the page has not been built: make page\n", 503)

    # Only these files are served; the path of a request is never used as the path of a file.
    files = {f"{row.base}{name}": path for row in hub.panels.rows for name, path in row.files().items()}

    async def of_panel(request: Request) -> Response:
        path = files.get(request.url.path.removeprefix("/"))
        return PlainTextResponse("telenano: no such file\n", 404) if path is None else FileResponse(path)

    routes: list[BaseRoute] = [
        Route("/recording/{ticket}", _Downloads(hub, connections)),
        Route("/panels/{path:path}", of_panel),
        WebSocketRoute("/bus", _PageSocket(hub, access, connections).serve),
        Route("/health", health),
        Route("/metrics", metrics),
        Mount("/", StaticFiles(directory=page, html=True)) if page is not None else Route("/", missing),
    ]
    return guarded(Starlette(routes=routes, lifespan=lifespan), access, connections)

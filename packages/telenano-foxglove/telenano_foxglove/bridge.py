"""A running rig for Foxglove and Lichtblick: every topic with its schema, over their web socket."""

import asyncio
import contextlib
import json
import secrets
import struct
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, MutableMapping, Sequence
from typing import Any, Protocol

from starlette.applications import Starlette
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from telenano.console import Rate
from telenano.recording import RecordedMessage, plain, viewer_json, viewer_schema
from telenano.serving import (
    Access,
    Connections,
    Listener,
    Tls,
    client_of,
    end_quietly,
    guarded,
    make_server,
    most_connections,
)
from telenano.wire import TOPICS, RecordingError

DEFAULT_PORT = 8765
# These topics are rarely plotted, and cost as much as everything else.
LEFT_OUT = ("node/journal", "link/fates")
# The protocols of the SDK and of the viewers before it; what is sent here is the same for both.
_PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
# a message: kind, subscription, time [ns]
_MESSAGE, _MESSAGE_DATA = struct.Struct("<BIQ"), 1
_ERROR = 2
_MOST_VIEWERS, _LEAST_STRANGERS, _MOST_QUEUED = 16, 8, 1024
_WRONG_TOKEN_S = 0.5
_POLICY = 1008
_START_S = 0.005


class Outlet(Protocol):
    """Where the messages of a channel go."""

    def log(self, msg: bytes, *, log_time: int) -> None:
        """Send a message of a time [ns]."""


class _Channel:
    """A channel that viewers may subscribe to; messages are handed over to the thread of the server."""

    def __init__(self, server: "FoxgloveServer", about: dict[str, Any]) -> None:
        self.about = about
        self._server = server

    def log(self, msg: bytes, *, log_time: int) -> None:
        self._server.send(int(self.about["id"]), log_time, msg)


class _Viewer:
    """A viewer that is connected: what it subscribed to, and what waits to be sent to it."""

    def __init__(self) -> None:
        # channel by the number that the viewer gave its subscription
        self.subscriptions: dict[int, int] = {}
        self._ready = asyncio.Event()
        self._texts: deque[str] = deque()
        # A frame that a viewer does not read in time is dropped.
        self._frames: deque[bytes] = deque(maxlen=_MOST_QUEUED)

    def tell(self, **fields: Any) -> None:
        """Queue a message of the server itself, which is never left out."""
        self._texts.append(json.dumps(fields, separators=(",", ":")))
        self._ready.set()

    def offer(self, channel: int, log_ns: int, payload: bytes) -> None:
        """Queue a message for each subscription to its channel."""
        for subscription, wanted in self.subscriptions.items():
            if wanted == channel:
                self._frames.append(_MESSAGE.pack(_MESSAGE_DATA, subscription, log_ns) + payload)
                self._ready.set()

    async def next_frame(self) -> str | bytes:
        while not (self._texts or self._frames):
            self._ready.clear()
            await self._ready.wait()
        return self._texts.popleft() if self._texts else self._frames.popleft()


class FoxgloveServer:
    """A server of the protocol foxglove.sdk.v1: one channel for each topic and source, as JSON with a schema.

    The server of the foxglove-sdk admits whoever connects, from a page of any site. This one has the rules
    of the page of the view: address, host name, origin and a token.
    """

    def __init__(self, bound: Listener, access: Access, tls: Tls | None = None) -> None:
        """Begin to serve at a socket, in a thread of its own; TelenanoError when it cannot."""
        self.port = int(bound.getsockname()[1])
        self._access = access
        self._session = secrets.token_hex(8)
        self._opened = 0
        # these belong to the thread of the server
        self._channels: list[dict[str, Any]] = []
        self._viewers: set[_Viewer] = set()
        # a copy that the thread of the messages reads: most of them nobody has asked for
        self._wanted: frozenset[int] = frozenset()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._connections = Connections(most_connections(_MOST_VIEWERS + _LEAST_STRANGERS))
        routes = [WebSocketRoute("/", self._serve)]
        app = guarded(Starlette(routes=routes, lifespan=self._lifespan), access, self._connections)
        self._server = make_server(app, tls)
        listener = bound.again(self._connections)
        self._thread = threading.Thread(target=self._server.run, kwargs={"sockets": [listener]}, name="foxglove")
        self._thread.start()
        while not self._server.started and self._thread.is_alive():
            time.sleep(_START_S)

    def open(self, name: str, schema_name: str, schema: bytes) -> Outlet:
        """Return a new channel."""
        self._opened += 1
        about = {
            "id": self._opened,
            "topic": name,
            "encoding": "json",
            "schemaName": schema_name,
            "schemaEncoding": "jsonschema",
            "schema": schema.decode(),
        }
        self._call(self._advertise, about)
        return _Channel(self, about)

    def send(self, channel: int, log_ns: int, payload: bytes) -> None:
        """Send a message to those that subscribed to its channel."""
        if channel in self._wanted:
            self._call(self._offer, channel, log_ns, payload)

    def close(self) -> None:
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

    def _call(self, function: Callable[..., None], *arguments: Any) -> None:
        loop = self._loop
        # a server that has not begun or has ended has no viewers
        with contextlib.suppress(RuntimeError):
            if loop is not None:
                loop.call_soon_threadsafe(function, *arguments)

    def _advertise(self, about: dict[str, Any]) -> None:
        self._channels.append(about)
        for viewer in self._viewers:
            viewer.tell(op="advertise", channels=[about])

    def _offer(self, channel: int, log_ns: int, payload: bytes) -> None:
        for viewer in self._viewers:
            viewer.offer(channel, log_ns, payload)

    async def _serve(self, socket: WebSocket) -> None:
        fault = await self._fault(socket)
        if fault:
            # before it is accepted: the viewer shows that the server refuses it
            await socket.close(_POLICY, fault)
            return
        self._connections.admit(client_of(socket.scope))
        await socket.accept(subprotocol=_chosen(socket.scope["subprotocols"]))
        viewer = _Viewer()
        viewer.tell(op="serverInfo", name="telenano", capabilities=[], metadata={}, sessionId=self._session)
        if self._channels:
            viewer.tell(op="advertise", channels=self._channels)
        self._viewers.add(viewer)
        sending = asyncio.create_task(_send_all(socket, viewer))
        try:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                while True:
                    self._take(viewer, await socket.receive())
        finally:
            self._viewers.discard(viewer)
            self._note_wanted()
            await end_quietly(sending)

    async def _fault(self, socket: WebSocket) -> str:
        """Return why a viewer is not admitted; empty when it is."""
        role = self._access.role_of(socket.query_params.get("token", ""))
        if role is None:
            await asyncio.sleep(_WRONG_TOKEN_S)
            return "the token is missing or wrong: open the address that the bridge printed"
        if len(self._viewers) >= _MOST_VIEWERS:
            return f"{len(self._viewers)} viewers are connected, which is as many as may be"
        if not _chosen(socket.scope["subprotocols"]):
            return f"a viewer speaks one of {', '.join(_PROTOCOLS)}"
        return ""

    def _take(self, viewer: _Viewer, message: MutableMapping[str, Any]) -> None:
        """Carry out what a viewer says; what it may not say is answered in words."""
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1000))
        try:
            fields = json.loads(message.get("text") or "")
            if fields["op"] == "subscribe":
                for wanted in fields["subscriptions"]:
                    self._subscribe(viewer, int(wanted["id"]), int(wanted["channelId"]))
            elif fields["op"] == "unsubscribe":
                for subscription in fields["subscriptionIds"]:
                    viewer.subscriptions.pop(int(subscription), None)
            else:
                raise ValueError(f"{fields['op']}: viewers subscribe and unsubscribe here, and nothing else")
        except (ValueError, KeyError, TypeError, AttributeError, ArithmeticError, RecursionError) as error:
            viewer.tell(op="status", level=_ERROR, message=f"Invalid message: {str(error)[:200]}")
        self._note_wanted()

    def _subscribe(self, viewer: _Viewer, subscription: int, channel: int) -> None:
        if not 0 < channel <= len(self._channels):
            raise ValueError(f"unknown channel {channel}")
        if not 0 <= subscription < 1 << 32:
            raise ValueError(f"subscription {subscription}: a number has 32 bits")
        if channel in viewer.subscriptions.values():
            raise ValueError(f"channel {channel} is subscribed to already")
        viewer.subscriptions[subscription] = channel

    def _note_wanted(self) -> None:
        self._wanted = frozenset(channel for viewer in self._viewers for channel in viewer.subscriptions.values())


def _chosen(offered: Sequence[str]) -> str | None:
    return next((name for name in _PROTOCOLS if name in offered), None)


async def _send_all(socket: WebSocket, viewer: _Viewer) -> None:
    while True:
        frame = await viewer.next_frame()
        await (socket.send_text(frame) if isinstance(frame, str) else socket.send_bytes(frame))


def address_of(port: int, access: Access, *, host: str, tls: bool) -> str:
    """Return the address to open in a viewer, with the token in its query, as they have no other place for it."""
    shown = f"[{host}]" if ":" in host else host
    return f"{'wss' if tls else 'ws'}://{shown}:{port}/?token={access.observer_token}"


class OpensOutlets(Protocol):
    """What a bridge opens its channels at."""

    def open(self, name: str, schema_name: str, schema: bytes) -> Outlet:
        """Return a new channel."""


class Bridge:
    """Hands messages on, of each channel no more than a rate.

    Channels are named topic@site/source, as `teleop/forward@slave/controller@master`: each is one line of a plot.
    """

    def __init__(self, server: OpensOutlets, rate_hz: float) -> None:
        """Prepare to hand on up to `rate_hz` messages a second of each channel [Hz]; 0 for all of them."""
        self.sent = 0
        self._server = server
        self._rate = Rate(rate_hz)
        self._outlets: dict[tuple[str, str], tuple[Outlet, dict[str, Any]]] = {}

    def run(self, messages: Iterable[RecordedMessage]) -> None:
        """Hand on messages until there are no more."""
        for message in messages:
            self.take(message)

    def take(self, message: RecordedMessage) -> None:
        """Hand on a message if its channel is due; topics sent on change always are, and what has no form never is."""
        if message.topic not in TOPICS or message.topic in LEFT_OUT or not self._rate.is_due(message):
            return
        key = message.channel_topic, message.src
        outlet, schema = self._outlets.get(key) or self._open(key, message.topic)
        try:
            payload = viewer_json(plain(message), schema)
        except (RecordingError, TypeError, ValueError):
            return
        outlet.log(payload, log_time=message.publish_ns)
        self.sent += 1

    def _open(self, key: tuple[str, str], topic: str) -> tuple[Outlet, dict[str, Any]]:
        model = TOPICS[topic].model
        schema = viewer_schema(model)
        opened = self._server.open("/".join(key), f"telenano.{model.__name__}", json.dumps(schema).encode())
        self._outlets[key] = opened, schema
        return opened, schema

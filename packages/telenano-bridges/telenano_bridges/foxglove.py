"""Serves a running rig to Foxglove and Lichtblick: every topic with its schema, over their web socket."""

import asyncio
import contextlib
import json
import os
import secrets
import struct
from collections import deque
from collections.abc import Callable, Iterable, MutableMapping, Sequence
from contextlib import AbstractContextManager
from typing import Annotated, Any, Protocol

import typer
from starlette.websockets import WebSocket, WebSocketDisconnect

from telenano.cli import DurationOption, SiteFileOption, report_errors, validated, with_options
from telenano.console import LiveRecording, hand_on, live_rig
from telenano.recording import RecordedMessage, viewer_json
from telenano.serving import TokenSocket, ViewConfig
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire import TOPICS, RecordingError

DEFAULT_PORT = 8765
# Topics that are not sent: they are rarely plotted, and cost as much as all others together.
LEFT_OUT = ("node/journal", "link/fates")
# The protocols of the SDK and of older viewers; the messages sent here are the same in both.
_PROTOCOLS = ("foxglove.sdk.v1", "foxglove.websocket.v1")
# The head of a frame with a message: opcode, subscription and time [ns].
_MESSAGE = struct.Struct("<BIQ")
# The opcode of a message.
_MESSAGE_DATA = 1
# The level of an error in a status message.
_ERROR = 2
# The largest number of viewers.
_MOST_VIEWERS = 16
# The largest number of frames that wait for a viewer; the oldest are dropped.
_MOST_QUEUED = 1024


class Outlet(Protocol):
    """The outlet of a channel, to which its messages are sent."""

    def log(self, msg: bytes, *, log_time: int) -> None:
        """Send an encoded message with its time [ns]."""


class _Channel:
    """A channel that viewers may subscribe to; it passes messages to the thread of the server."""

    def __init__(self, server: "FoxgloveServer", about: dict[str, Any]) -> None:
        self.about = about
        self._server = server

    def log(self, msg: bytes, *, log_time: int) -> None:
        self._server.send(int(self.about["id"]), log_time, msg)


class _Viewer:
    """A connected viewer: its subscriptions, and the queue of messages to it."""

    def __init__(self) -> None:
        # The channel of each subscription, by the number that the viewer has given it.
        self.subscriptions: dict[int, int] = {}
        self._ready = asyncio.Event()
        self._texts: deque[str] = deque()
        # A frame that a viewer does not read in time is dropped.
        self._frames: deque[bytes] = deque(maxlen=_MOST_QUEUED)

    def tell(self, **fields: Any) -> None:
        """Queue a message of the server itself, which is never dropped."""
        self._texts.append(json.dumps(fields, separators=(",", ":")))
        self._ready.set()

    def offer(self, channel: int, log_ns: int, payload: bytes) -> None:
        """Queue a message of a channel for each subscription to it."""
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

    The server of the foxglove-sdk would admit every client, even a page of any web site. This one applies the rules of
    the page of the view (`TokenSocket`): address, host name, origin and a token.
    """

    def __init__(self, config: ViewConfig, token: str = "", origins: Sequence[str] = ()) -> None:
        """Begin to serve in a thread of its own; raise TelenanoError if that is impossible.

        Args:
            config: The address to serve on, and the clients that may connect.
            token: The token of the viewers; empty for a new one.
            origins: The origins of the pages that may be viewers.
        """
        self._session = secrets.token_hex(8)
        self._opened = 0
        # Only the thread of the server uses these.
        self._channels: list[dict[str, Any]] = []
        self._viewers: set[_Viewer] = set()
        # A copy for the thread of the messages, which drops the many messages that nobody has subscribed to.
        self._wanted: frozenset[int] = frozenset()
        self._socket = TokenSocket(
            config, self._serve, _PROTOCOLS, what="the bridge", token=token, origins=origins, most=_MOST_VIEWERS
        )
        self.port, self.address = self._socket.port, self._socket.address

    def open(self, name: str, schema_name: str, schema: bytes) -> Outlet:
        """Open a channel, advertise it to the viewers, and return its outlet."""
        self._opened += 1
        about = {
            "id": self._opened,
            "topic": name,
            "encoding": "json",
            "schemaName": schema_name,
            "schemaEncoding": "jsonschema",
            "schema": schema.decode(),
        }
        self._socket.call(self._advertise, about)
        return _Channel(self, about)

    def send(self, channel: int, log_ns: int, payload: bytes) -> None:
        """Send a message to the viewers that have subscribed to its channel."""
        if channel in self._wanted:
            self._socket.call(self._offer, channel, log_ns, payload)

    def announced(self, called: str, show: Callable[[str], None]) -> AbstractContextManager[None]:
        """Keep the address in a private file while a block runs, and show it on a terminal."""
        return self._socket.announced(called, show, "bridge")

    def close(self) -> None:
        self._socket.close()

    def _advertise(self, about: dict[str, Any]) -> None:
        self._channels.append(about)
        for viewer in self._viewers:
            viewer.tell(op="advertise", channels=[about])

    def _offer(self, channel: int, log_ns: int, payload: bytes) -> None:
        for viewer in self._viewers:
            viewer.offer(channel, log_ns, payload)

    async def _serve(self, socket: WebSocket) -> None:
        viewer = _Viewer()
        viewer.tell(op="serverInfo", name="telenano", capabilities=[], metadata={}, sessionId=self._session)
        if self._channels:
            viewer.tell(op="advertise", channels=self._channels)
        self._viewers.add(viewer)
        sending = asyncio.create_task(_send_all(socket, viewer))
        try:
            while True:
                self._take(viewer, await socket.receive())
        finally:
            self._viewers.discard(viewer)
            self._note_wanted()
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)

    def _take(self, viewer: _Viewer, message: MutableMapping[str, Any]) -> None:
        """Carry out a request of a viewer; answer an invalid one with an error text."""
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
                raise ValueError(f"{fields['op']}: is not supported; viewers can only subscribe and unsubscribe")
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


async def _send_all(socket: WebSocket, viewer: _Viewer) -> None:
    while True:
        frame = await viewer.next_frame()
        await (socket.send_text(frame) if isinstance(frame, str) else socket.send_bytes(frame))


class OpensOutlets(Protocol):
    """The server at which a bridge opens its channels."""

    def open(self, name: str, schema_name: str, schema: bytes) -> Outlet:
        """Open a channel with a JSON schema, and return its outlet."""


class Bridge:
    """Forwards the messages of a rig to a server.

    Channels are named topic@site/source, as `teleop/forward@slave/controller@master`: each is one line of a plot.
    """

    def __init__(self, server: OpensOutlets) -> None:
        self.sent = 0
        self._server = server
        self._outlets: dict[tuple[str, str], tuple[Outlet, Callable[[dict[str, Any]], bytes]]] = {}

    def run(self, messages: Iterable[RecordedMessage]) -> None:
        """Forward messages until there are no more."""
        for message in messages:
            self.take(message)

    def take(self, message: RecordedMessage) -> None:
        """Forward a message; drop it if its topic is unknown or left out, or if it cannot be encoded."""
        if message.topic not in TOPICS or message.topic in LEFT_OUT:
            return
        key = message.channel_topic, message.src
        outlet, encode = self._outlets.get(key) or self._open(key, message.topic)
        try:
            payload = encode(message.plain())
        except (RecordingError, TypeError, ValueError):
            return
        outlet.log(payload, log_time=message.publish_ns)
        self.sent += 1

    def _open(self, key: tuple[str, str], topic: str) -> tuple[Outlet, Callable[[dict[str, Any]], bytes]]:
        _, (name, _, schema), encode = viewer_json(topic)
        opened = self._outlets[key] = self._server.open("/".join(key), name, schema), encode
        return opened


TOKEN_VARIABLE = "TELENANO_BRIDGE_TOKEN"


@with_options(ViewConfig, leave_out=("port",))
def foxglove(
    given: dict[str, Any],
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    port: Annotated[int, typer.Option("--port", min=0, max=65535, metavar="N", help="Port.")] = DEFAULT_PORT,
    allow_origin: Annotated[
        list[str] | None,
        typer.Option(
            "--allow-origin",
            metavar="ORIGIN",
            help="Pages that may connect, as https://app.foxglove.dev, or null (repeatable).",
        ),
    ] = None,
    rate: Annotated[
        float,
        typer.Option(
            "--rate", min=0.0, metavar="HZ", help="Greatest number of messages of each channel per second; 0: all."
        ),
    ] = LiveRecording.VIEWER_HZ,
    duration: DurationOption = None,
) -> None:
    """Serve every topic with its schema to Foxglove and Lichtblick, until Ctrl-C; prints the address to open.

    The address ends with a token, that of TELENANO_BRIDGE_TOKEN or a new one. If the output is no terminal, the address
    goes to a file that only its owner can read.
    """
    with report_errors(False):
        config = validated(ViewConfig, {**given, "port": port})
        token = os.environ.get(TOKEN_VARIABLE, "")
        with (
            live_rig(site_file, rate_hz=rate) as live,
            contextlib.closing(FoxgloveServer(config, token, allow_origin or ())) as server,
            server.announced("open in Foxglove or Lichtblick", typer.echo),
        ):
            hand_on(Bridge(server), live, duration)

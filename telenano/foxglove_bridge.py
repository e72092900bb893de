"""A running rig for Foxglove and Lichtblick: every topic with its schema, over their web socket."""

import json
from collections.abc import Iterable
from typing import Any, Protocol

from proto import TOPICS
from proto.errors import EndpointError
from recording.export import fitted, plain_schema
from recording.messages import RecordedMessage
from recording.tables import plain

DEFAULT_PORT = 8765
DEFAULT_RATE_HZ = 100.0
# what nobody plots, and what costs as much as everything else
LEFT_OUT = ("node/journal", "link/fates")


class Outlet(Protocol):
    """Where the messages of a channel go."""

    def log(self, msg: bytes, *, log_time: int) -> None:
        """Send a message of a time [ns]."""


class FoxgloveServer:
    """The server of the foxglove-sdk: one channel for each topic and source, as JSON with a schema."""

    def __init__(self, host: str, port: int) -> None:
        """Begin to serve; EndpointError when the port is taken."""
        # an extra
        import foxglove

        self._sdk: Any = foxglove
        try:
            self._server = foxglove.start_server(name="telenano", host=host, port=port)
        except (RuntimeError, OSError) as error:
            raise EndpointError(f"the bridge cannot bind {host}:{port}: {error}: give another --port") from error
        self.port = int(self._server.port)

    def open(self, name: str, schema_name: str, schema: bytes) -> Outlet:
        """Return a new channel."""
        described = self._sdk.Schema(name=schema_name, encoding="jsonschema", data=schema)
        outlet: Outlet = self._sdk.Channel(name, message_encoding="json", schema=described)
        return outlet

    def close(self) -> None:
        self._server.stop()


class OpensOutlets(Protocol):
    """What a bridge opens its channels at."""

    def open(self, name: str, schema_name: str, schema: bytes) -> Outlet:
        """Return a new channel."""


class Bridge:
    """Hands messages on, of each channel no more than a rate: 8000 a second would be more than a viewer draws.

    Channels are named topic@site/source, as `teleop/forward@slave/controller@master`: each is one line of a plot.
    """

    def __init__(self, server: OpensOutlets, rate_hz: float) -> None:
        """Prepare to hand on up to `rate_hz` messages a second of each channel [Hz]; 0 for all of them."""
        self.sent = 0
        self._server = server
        self._period_ns = round(1e9 / rate_hz) if rate_hz > 0.0 else 0
        self._outlets: dict[tuple[str, str], tuple[Outlet, dict[str, Any]]] = {}
        self._due_ns: dict[tuple[str, str], int] = {}

    def run(self, messages: Iterable[RecordedMessage]) -> None:
        """Hand on messages until there are no more."""
        for message in messages:
            self.take(message)

    def take(self, message: RecordedMessage) -> None:
        """Hand on a message if its channel is due; topics sent on change always are."""
        row = TOPICS.get(message.topic)
        if row is None or message.topic in LEFT_OUT:
            return
        key = message.channel_topic, message.src
        if row.rate_hz is not None and self._period_ns:
            due_ns = self._due_ns.get(key, 0)
            if message.log_ns < due_ns:
                return
            # on the grid of the rate, unless the channel was silent
            kept = message.log_ns - due_ns < self._period_ns
            self._due_ns[key] = (due_ns if kept else message.log_ns) + self._period_ns
        outlet, schema = self._outlets.get(key) or self._open(key, message.topic)
        payload = json.dumps(fitted(plain(message), schema), separators=(",", ":")).encode()
        outlet.log(payload, log_time=message.publish_ns)
        self.sent += 1

    def _open(self, key: tuple[str, str], topic: str) -> tuple[Outlet, dict[str, Any]]:
        model = TOPICS[topic].model
        schema = plain_schema(model.model_json_schema())
        opened = self._server.open("/".join(key), f"telenano.{model.__name__}", json.dumps(schema).encode())
        self._outlets[key] = opened, schema
        return opened, schema

"""What a viewer is handed: names, rates, schemas that its messages fit."""

import contextlib
import json
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import pytest
from telenano_bridges.foxglove import LEFT_OUT, Bridge, FoxgloveServer

from telenano.serving import ViewConfig
from telenano.testing import EPOCH_NS, hand_state, numbered, received
from telenano.wire import OWN_TOPICS as TOPICS
from telenano.wire import TelenanoError


class Server:
    """Keeps what a viewer would get."""

    def __init__(self) -> None:
        self.schemas: dict[str, dict[str, Any]] = {}
        self.sent: list[tuple[str, dict[str, Any], int]] = []

    def open(self, name: str, schema_name: str, schema: bytes) -> Any:
        self.schemas[name] = {"name": schema_name, **json.loads(schema)}
        server = self

        class Outlet:
            def log(self, msg: bytes, *, log_time: int) -> None:
                server.sent.append((name, json.loads(msg), log_time))

        return Outlet()


def test_copies_and_sources_are_lines_of_their_own() -> None:
    server = Server()
    sources = [("controller@master", ""), ("controller@slave", ""), ("controller@slave", "master")]
    messages = [
        received("law/status", numbered("law/status", 0, src=src), i, site) for i, (src, site) in enumerate(sources)
    ]
    Bridge(server).run(messages)
    assert list(server.schemas) == [
        "law/status/controller@master",
        "law/status/controller@slave",
        "law/status@master/controller@slave",
    ]


@pytest.mark.parametrize("topic", sorted(TOPICS))
def test_every_message_has_the_keys_and_kinds_of_its_schema(topic: str) -> None:
    server = Server()
    Bridge(server).take(received(topic, numbered(topic, 3), 0))
    if topic in LEFT_OUT:
        assert server.sent == []
        return
    (name, fields, time_ns), schema = server.sent[0], next(iter(server.schemas.values()))
    assert name.startswith(f"{topic}/")
    assert time_ns == EPOCH_NS + 3_000_000
    kinds = {"number": int | float, "integer": int, "boolean": bool, "string": str, "array": list, "object": dict}
    for key, value in fields.items():
        assert isinstance(value, kinds[schema["properties"][key]["type"]]), key
    assert "$ref" not in json.dumps(schema)


TOKEN = "token-of-the-tests-1"
SUBPROTOCOL = "foxglove.sdk.v1"


@pytest.fixture
def served() -> Iterator[FoxgloveServer]:
    pytest.importorskip("uvicorn")
    config = ViewConfig(port=0)
    with contextlib.closing(FoxgloveServer(config, TOKEN, ["https://app.foxglove.dev"])) as server:
        yield server


def viewer(
    served: FoxgloveServer, token: str = TOKEN, subprotocols: Sequence[str] = (SUBPROTOCOL,), **given: Any
) -> Any:
    client = pytest.importorskip("websockets.sync.client")
    address = f"ws://127.0.0.1:{served.port}/?token={token}"
    return client.connect(address, subprotocols=list(subprotocols), compression=None, **given)


def advertised(frames: Iterable[Any], name: str) -> dict[str, Any]:
    """Return the channel of a name from what a viewer is told."""
    return next(
        channel
        for text in frames
        if json.loads(text)["op"] == "advertise"
        for channel in json.loads(text)["channels"]
        if channel["topic"] == name
    )


def first_data(found: Any, send: Callable[[int], None]) -> bytes:
    """Send until something arrives: a server takes up a subscription in its own time, and sends nothing twice."""
    frame: Any = ""
    for number in range(1000):
        send(number)
        with contextlib.suppress(TimeoutError):
            frame = found.recv(timeout=0.02)
        if isinstance(frame, bytes):
            return frame
    raise AssertionError("nothing arrived")


@pytest.mark.parametrize("is_early", [True, False], ids=["channel first", "viewer first"])
def test_a_viewer_finds_the_channels_and_gets_the_messages(served: FoxgloveServer, is_early: bool) -> None:
    bridge = Bridge(served)
    if is_early:
        bridge.take(received("haptic/state", hand_state(0), 0))
    with viewer(served) as found:
        assert found.subprotocol == SUBPROTOCOL
        assert json.loads(found.recv())["op"] == "serverInfo"
        if not is_early:
            bridge.take(received("haptic/state", hand_state(0), 0))
        channel = advertised(found, "haptic/state/haptic_node@master")
        assert channel["schemaName"] == "telenano.HapticState"
        found.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": channel["id"]}]}))
        frame = first_data(found, lambda i: bridge.take(received("haptic/state", hand_state(i % 500), i + 1)))
        # one byte of kind, the subscription, the time [ns], the message
        assert (frame[0], int.from_bytes(frame[1:5], "little")) == (1, 7)
        assert int.from_bytes(frame[5:13], "little") >= EPOCH_NS
        assert json.loads(frame[13:])["src"] == "haptic_node@master"
        found.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [7]}))
        end = time.monotonic() + 10.0
        while served._wanted:
            assert time.monotonic() < end
            time.sleep(0.005)


@pytest.mark.parametrize("token", ["", "wrong-token-of-tests"])
def test_who_has_no_token_gets_nothing(served: FoxgloveServer, token: str) -> None:
    from websockets.exceptions import InvalidStatus

    with pytest.raises(InvalidStatus) as refused, viewer(served, token):
        pass
    assert refused.value.response.status_code == 403


@pytest.mark.parametrize("origin", ["https://evil.example", "null", "http://127.0.0.1:1"])
def test_a_page_of_any_other_site_gets_nothing_even_with_the_token(served: FoxgloveServer, origin: str) -> None:
    from websockets.exceptions import InvalidStatus

    with pytest.raises(InvalidStatus), viewer(served, origin=origin):
        pass


def test_pages_that_are_named_and_the_server_s_own_are_admitted(served: FoxgloveServer) -> None:
    for origin in ("https://app.foxglove.dev", f"http://127.0.0.1:{served.port}", None):
        with viewer(served, origin=origin) as found:
            assert json.loads(found.recv())["op"] == "serverInfo"


def test_a_viewer_of_another_protocol_is_refused(served: FoxgloveServer) -> None:
    from websockets.exceptions import InvalidStatus

    with pytest.raises(InvalidStatus), viewer(served, subprotocols=["other.v1"]):
        pass


@pytest.mark.parametrize(
    "text",
    [
        "garbage",
        "[]",
        "3",
        "{}",
        '{"op": "advertise", "channels": []}',
        '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 999}]}',
        '{"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1e999}]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        "[" * 50_000,
        b"\x01\x00\x00\x00\x00",
    ],
)
def test_what_a_viewer_may_not_say_is_answered_and_disturbs_nobody(served: FoxgloveServer, text: str | bytes) -> None:
    bridge = Bridge(served)
    bridge.take(received("haptic/state", hand_state(0), 0))
    with viewer(served) as other, viewer(served) as found:
        found.send(text)
        status = next(fields for fields in map(json.loads, found) if fields["op"] == "status")
        assert status["level"] == 2
        channel = advertised(other, "haptic/state/haptic_node@master")
        other.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel["id"]}]}))
        assert first_data(other, lambda i: bridge.take(received("haptic/state", hand_state(i % 500), i + 1)))


def test_what_is_said_is_what_the_server_of_the_sdk_says(served: FoxgloveServer) -> None:
    foxglove = pytest.importorskip("foxglove")
    client = pytest.importorskip("websockets.sync.client")
    theirs = foxglove.start_server(name="telenano", host="127.0.0.1", port=0)
    schema = foxglove.Schema(name="telenano.X", encoding="jsonschema", data=b'{"type":"object"}')
    channel = foxglove.Channel("a/b@master", message_encoding="json", schema=schema)
    ours = served.open("a/b@master", "telenano.X", b'{"type":"object"}')
    address = f"ws://127.0.0.1:{theirs.port}"
    try:
        with viewer(served) as a, client.connect(address, subprotocols=[SUBPROTOCOL]) as b:
            info = [json.loads(found.recv()) for found in (a, b)]
            assert {key: type(value) for key, value in info[0].items()} == {
                key: type(value) for key, value in info[1].items()
            }
            assert info[0]["capabilities"] == info[1]["capabilities"] == []
            adverts = [advertised(found, "a/b@master") for found in (a, b)]
            for found, advert in zip((a, b), adverts, strict=True):
                wanted = {"id": 3, "channelId": advert.pop("id")}
                found.send(json.dumps({"op": "subscribe", "subscriptions": [wanted]}))
            assert adverts[0] == adverts[1]
            frames = [
                first_data(found, lambda i, outlet=outlet: outlet.log(b'{"x":1}', log_time=10**18))
                for found, outlet in ((a, ours), (b, channel))
            ]
            assert frames[0] == frames[1]
    finally:
        theirs.stop()


def test_a_port_that_is_taken_is_named(served: FoxgloveServer) -> None:
    with pytest.raises(TelenanoError, match=f"the bridge cannot bind 127.0.0.1:{served.port}"):
        FoxgloveServer(ViewConfig(port=served.port))


@pytest.mark.parametrize(
    ("settings", "address"),
    [
        ({}, "ws://127.0.0.1:{}/?token="),
        ({"host": "::1"}, "ws://[::1]:{}/?token="),
        ({"names": ("afm",)}, "ws://afm:{}/?token="),
    ],
)
def test_an_address_has_the_token_where_a_viewer_can_have_it(settings: dict[str, Any], address: str) -> None:
    pytest.importorskip("uvicorn")
    with contextlib.closing(FoxgloveServer(ViewConfig(port=0, **settings), TOKEN)) as server:
        assert server.address == address.format(server.port) + TOKEN

"""What a viewer is handed: names, rates, schemas that its messages fit."""

import json
from typing import Any

import pytest
from recorder_samples import EPOCH_NS, MILLISECOND_NS, haptic_state, sample

from proto import TOPICS, encode
from proto.errors import EndpointError
from proto.messages import Message
from recording.messages import RecordedChannel, RecordedMessage
from telenano.foxglove_bridge import LEFT_OUT, Bridge, FoxgloveServer


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


def recorded(topic: str, message: Message, number: int, site: str = "") -> RecordedMessage:
    row, channel_topic = TOPICS[topic], f"{topic}@{site}" if site else topic
    channel = RecordedChannel(channel_topic, topic, site, "direct", message.src, row.rate_hz, row.delivery)
    log_ns = EPOCH_NS + number * MILLISECOND_NS
    return RecordedMessage(channel, log_ns, message.t_ns, message.seq, encode(message))


@pytest.mark.parametrize(("rate_hz", "count"), [(100.0, 100), (250.0, 250), (0.0, 1000)])
def test_a_channel_has_the_rate_that_was_asked_for(rate_hz: float, count: int) -> None:
    server = Server()
    Bridge(server, rate_hz).run(recorded("haptic/state", haptic_state(i % 500), i) for i in range(1000))
    assert len(server.sent) == count
    assert {name for name, _, _ in server.sent} == {"haptic/state/haptic_node@master"}


def test_what_is_sent_on_change_is_never_left_out() -> None:
    server = Server()
    Bridge(server, 1.0).run(recorded("session/event", sample("session/event", i), i) for i in range(20))
    assert [fields["seq"] for _, fields, _ in server.sent] == list(range(20))


def test_copies_and_sources_are_lines_of_their_own() -> None:
    server = Server()
    sources = [("controller@master", ""), ("controller@slave", ""), ("controller@slave", "master")]
    messages = [
        recorded("law/status", sample("law/status", 0, src=src), i, site) for i, (src, site) in enumerate(sources)
    ]
    Bridge(server, 100.0).run(messages)
    assert list(server.schemas) == [
        "law/status/controller@master",
        "law/status/controller@slave",
        "law/status@master/controller@slave",
    ]


@pytest.mark.parametrize("topic", sorted(TOPICS))
def test_every_message_has_the_keys_and_kinds_of_its_schema(topic: str) -> None:
    server = Server()
    Bridge(server, 0.0).take(recorded(topic, sample(topic, 3), 0))
    if topic in LEFT_OUT:
        assert server.sent == []
        return
    (name, fields, time_ns), schema = server.sent[0], next(iter(server.schemas.values()))
    assert name.startswith(f"{topic}/")
    assert time_ns == EPOCH_NS + 3 * MILLISECOND_NS
    kinds = {"number": int | float, "integer": int, "boolean": bool, "string": str, "array": list, "object": dict}
    for key, value in fields.items():
        assert isinstance(value, kinds[schema["properties"][key]["type"]]), key
    assert "$ref" not in json.dumps(schema)


def test_a_viewer_finds_the_channels_and_gets_the_messages() -> None:
    pytest.importorskip("foxglove")
    client = pytest.importorskip("websockets.sync.client")
    served = FoxgloveServer("127.0.0.1", 0)
    try:
        bridge = Bridge(served, 0.0)
        bridge.take(recorded("haptic/state", haptic_state(0), 0))
        with client.connect(f"ws://127.0.0.1:{served.port}", subprotocols=["foxglove.sdk.v1"]) as viewer:
            channel = next(
                channel
                for text in viewer
                if json.loads(text)["op"] == "advertise"
                for channel in json.loads(text)["channels"]
                if channel["topic"] == "haptic/state/haptic_node@master"
            )
            assert channel["schemaName"] == "telenano.HapticState"
            wanted = {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel["id"]}]}
            viewer.send(json.dumps(wanted))
            number = 0
            frame: Any = ""
            while not isinstance(frame, bytes):
                # the server takes up a subscription in its own time, and what was sent before is not sent again
                number += 1
                bridge.take(recorded("haptic/state", haptic_state(number), number))
                try:
                    frame = viewer.recv(timeout=0.02)
                except TimeoutError:
                    assert number < 1000
            # one byte of kind, the subscription, the time [ns], the message
            assert json.loads(frame[13:])["seq"] >= 1
    finally:
        served.close()


def test_a_port_that_is_taken_is_named() -> None:
    pytest.importorskip("foxglove")
    served = FoxgloveServer("127.0.0.1", 0)
    try:
        with pytest.raises(EndpointError, match=f"127.0.0.1:{served.port}"):
            FoxgloveServer("127.0.0.1", served.port)
    finally:
        served.close()

"""Every field of every topic with a value that it may not have, one at a time, before all that consume messages.

Messages that the wire refuses have to be counted and to end nothing; the extreme ones that it takes are shown, recorded
and handed on.
"""

import itertools
import json
import math
import random
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest
import zmq
from made_sessions import BEGAN_NS, MS, Made
from made_source import MadeSource
from telenano_bridges.foxglove import LEFT_OUT, _Viewer
from telenano_bridges.foxglove import Bridge as FoxgloveBridge
from telenano_bridges.lsl import MARKERS, STATES, LslBridge, Sample, Stream
from telenano_bridges.ros2 import TEXTS, Encoder, Ros2Bridge, Ros2Message

from services.recorder.intake import Intake
from services.viz_node.document import RecordingDocument
from services.viz_node.feed import SeenMessage, seen
from services.viz_node.hub import Hub
from services.viz_node.playback import RecordingPlayback
from services.viz_node.source import TOPICS_SHOWN
from telenano.analysis.recording_document import judged_recording
from telenano.analysis.report import write_report
from telenano.console.listener import Listener
from telenano.recording.channel_filter import ALL
from telenano.recording.messages import LeftOut, RecordedChannel, RecordedMessage, readable
from telenano.recording.multi_file import open_recordings
from telenano.recording.reader import Recording
from telenano.recording.writer import FileSettings, RecordingWriter
from telenano.runtime.bus.bus import Subscriber
from telenano.serving.access import Role
from telenano.testing import VirtualClock
from telenano.testing.filled_messages import examples
from telenano.wire import encode
from telenano.wire.topics import OWN_TOPICS as TOPICS

SEED = 42
SITES = {"haptic_node": "master", "delay_node": "master", "launcher": "master", "view": "master"}
EXTREMES: tuple[Any, ...] = (
    math.nan, math.inf, -math.inf, 1.7e308, -1.7e308, 2**63 - 1, 2**64 - 1, -(2**63), -1, 0, True, None, "x",
    "x" * 70_000, "\ud800".encode("utf-8", "surrogatepass"), b"\0" * 9, [], [[[]]] * 3, {}, {"a": {"b": math.inf}},
)  # fmt: skip
# The cheap part takes so many of some seven thousand messages.
CHEAP = 400


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the way to each part of a message."""
    if path:
        yield path
    parts = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in parts:
        yield from places(part, (*path, key))


def changed(value: Any, path: tuple[Any, ...], extreme: Any) -> Any:
    if not path:
        return extreme
    copy = dict(value) if isinstance(value, dict) else list(value)
    copy[path[0]] = changed(value[path[0]], path[1:], extreme)
    return copy


def publisher_of(topic: str) -> str:
    name = TOPICS[topic].publishers[0].replace("*", "afm_node")
    return name if "@" in name else f"{name}@{SITES.get(name, 'slave')}"


def ordinary_of(topic: str) -> dict[str, Any]:
    example = msgpack.unpackb(encode(examples(TOPICS[topic])["ordinary"]))
    return dict(example | {"src": publisher_of(topic), "t_ns": BEGAN_NS})


def fuzzed(count: int | None) -> list[tuple[str, bytes]]:
    """Return topics and payloads in an order by chance, each with one part that is extreme or absent."""
    made = []
    for topic in TOPICS:
        ordinary = ordinary_of(topic)
        for path in places(ordinary):
            made += [(topic, msgpack.packb(changed(ordinary, path, extreme))) for extreme in EXTREMES]
        made += [(topic, msgpack.packb({k: v for k, v in ordinary.items() if k != key})) for key in ordinary]
    random.Random(SEED).shuffle(made)
    return made[:count]


@pytest.fixture(params=[CHEAP, pytest.param(None, marks=pytest.mark.endurance)], ids=["some", "all"])
def messages(request: pytest.FixtureRequest) -> list[tuple[str, bytes]]:
    return fuzzed(request.param)


@pytest.fixture
def reader() -> Iterator[Subscriber]:
    """Give a subscriber without connection: its messages are handed to it."""
    with zmq.Context() as context:
        made = Subscriber(context, VirtualClock(), {"inproc://nowhere": ["haptic/state"]})
        yield made
        made.close()


def recorded(topic: str, payload: bytes, log_ns: int = BEGAN_NS) -> RecordedMessage:
    src = publisher_of(topic)
    channel = RecordedChannel(topic, topic, src.partition("@")[2], "direct", src, None, TOPICS[topic].delivery)
    return RecordedMessage(channel, log_ns, log_ns, 0, payload)


class Source(MadeSource):
    def __init__(self, reader: Subscriber) -> None:
        super().__init__()
        self.reader, self.frames = reader, list[tuple[str, bytes]]()

    def poll(self, *, watched: bool) -> Iterator[SeenMessage]:
        taken, self.frames = self.frames, []
        for topic, payload in taken:
            if (accepted := self.reader.accepted([topic.encode(), payload])) is not None:
                yield seen(topic, accepted[1].src, accepted[1].t_ns, accepted[1])


def test_pages_of_all_roles_and_the_metrics_outlive_them(reader: Subscriber, messages: list[tuple[str, bytes]]) -> None:
    source = Source(reader)
    hub = Hub(source)
    pages = [hub.join(role) for role in Role]
    shown = [(topic, payload) for topic, payload in messages if topic in TOPICS_SHOWN]
    for number, message in enumerate(shown):
        source.frames.append(message)
        hub.tick()
        if number % 50 == 0:
            for page in pages:
                msgpack.unpackb(hub.snapshot(page), strict_map_key=False)
        assert "telenano_state" in hub.metrics(number * 10**9)
    # What the wire refuses is counted by its reason; the little that is valid and no page can draw as well.
    assert sum(reader.rejected.values()) > 0.5 * len(shown)
    assert set(reader.rejected) <= {"schema", "range", "malformed", "oversized", "source", "newer_version"}
    assert sum(hub.left_out.rejected.values()) < 0.05 * len(shown)


@pytest.mark.unchecked("its numbers and answers are made up")
def test_a_recorder_keeps_them_as_they_came(
    reader: Subscriber, messages: list[tuple[str, bytes]], tmp_path: Path
) -> None:
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=tmp_path, file_name="all.mcap"))
    intake = Intake(writer, selection=ALL)
    listeners = {topic: Listener(publisher_of(topic), reader) for topic in TOPICS}
    for topic, payload in messages:
        intake.record(listeners[topic], [topic.encode(), payload], BEGAN_NS)
    intake.finish()
    assert intake.fault == ""
    assert intake.rejected > 0
    info = Recording(writer.path).info()
    assert info.messages >= len(messages)


def test_what_bridges_are_handed_has_a_plain_form(reader: Subscriber, messages: list[tuple[str, bytes]]) -> None:
    taken = [each for each in messages if reader.accepted([each[0].encode(), each[1]]) is not None]
    for topic, payload in taken:
        assert json.dumps(recorded(topic, payload).plain(), allow_nan=False)
    assert len(taken) + sum(reader.rejected.values()) == len(messages)
    assert sum(reader.rejected.values()) > 0.5 * len(messages)


class Outlets:
    """What each bridge hands its messages to: it makes bytes of them, as the library behind it does."""

    def __init__(self) -> None:
        self.viewer = _Viewer()
        self.viewer.subscriptions = {1: 1}
        self.encoder = Encoder()

    def lsl(self, stream: Stream) -> Callable[[Sample], None]:
        def send(sample: Sample) -> None:
            if len(sample.values) != len(stream.channels):
                raise ValueError("the sample has another length than the stream has channels")
            for value in sample.values:
                assert value.encode() if isinstance(value, str) else struct.pack("<d", value)
            assert math.isfinite(sample.time_s)

        return send

    def open(self, name: str, schema_name: str, schema: bytes) -> "Outlets":
        json.loads(schema)
        return self

    def log(self, msg: bytes, *, log_time: int) -> None:
        json.loads(msg)
        self.viewer.offer(1, log_time, msg)

    def ros2(self, topic: str, kind: str, definition: str, type_hash: str) -> Any:
        encoder = self.encoder

        class Publisher:
            def publish(self, **fields: Any) -> None:
                assert encoder.cdr(Ros2Message(topic, kind, encoder.store.types[kind](**fields)))

        return Publisher()


# Each bridge, and the topics of which it hands on every valid message.
BRIDGES: dict[str, tuple[Callable[[], Any], tuple[str, ...]]] = {
    "foxglove": (lambda: FoxgloveBridge(Outlets()), tuple(set(TOPICS) - set(LEFT_OUT))),
    "lsl": (
        lambda: LslBridge(Outlets().lsl, lambda: 1.0, 0),
        tuple(topic for topic in (*STATES, *MARKERS) if topic in TOPICS),
    ),
    "ros2": (lambda: Ros2Bridge(Outlets().ros2), TEXTS),
}


@pytest.mark.parametrize("name", BRIDGES)
def test_no_message_ends_a_bridge(reader: Subscriber, messages: list[tuple[str, bytes]], name: str) -> None:
    make, whole = BRIDGES[name]
    bridge = make()
    valid = [each for each in messages if reader.accepted([each[0].encode(), each[1]]) is not None]
    ordinary = {topic: recorded(topic, msgpack.packb(ordinary_of(topic))) for topic in TOPICS}
    journal = ordinary["node/journal"]
    # A clock is known by the journal of its node.
    channels = [journal.channel._replace(src=publisher_of(topic)) for topic in STATES]
    bridge.run(iter([*(journal._replace(channel=channel) for channel in channels), *ordinary.values()]))
    assert bridge.sent >= len(whole)
    bridge.run(iter([recorded(*each) for each in messages]))
    before = bridge.sent
    bridge.run(iter([recorded(topic, payload) for topic, payload in valid if topic in whole]))
    assert bridge.sent - before == sum(topic in whole for topic, _ in valid) > 0


@pytest.mark.check("takes 2.0 s")
def test_report_playback_and_document_leave_out_what_is_not_valid(
    messages: list[tuple[str, bytes]], tmp_path: Path
) -> None:
    sound = Made().write(tmp_path)
    wrong = [each for each in messages if not list(readable([recorded(*each)], LeftOut()))]
    assert len(wrong) > 0.5 * len(messages)
    file = FileSettings(directory=tmp_path, file_name="fuzzed.mcap")
    writer = RecordingWriter.create("recorder@master", file)
    writer.attach("scenario.yaml", "application/yaml", Recording(sound).attachments["scenario.yaml"], BEGAN_NS)
    writer.add_metadata("recording", {"node": "recorder@master"})
    rows = [
        (m.log_ns, m.topic, m.src, m.channel.site, m.publish_ns, m.seq, m.payload) for m in Recording(sound).messages()
    ]
    first_ns = min(row[0] for row in rows)
    for number, (topic, payload) in enumerate(wrong):
        # Each comes when its session runs, stamped and numbered as its neighbours are.
        at_ns = first_ns + 500 * MS + number * (7500 * MS // len(wrong))
        src = publisher_of(topic)
        rows.append((at_ns, topic, src, src.partition("@")[2], at_ns, 10**6 + number, payload))
    channels = {key: writer.channel(*key) for key in {row[1:4] for row in rows}}
    for log_ns, topic, src, site, publish_ns, seq, payload in sorted(rows, key=lambda row: row[0]):
        writer.write(channels[topic, src, site], log_ns, publish_ns, seq, payload)
    writer.finish()
    whole, fuzzed_summary = (write_report(path, tmp_path / path.stem) for path in (sound, writer.path))
    for key in ("duration_s", "holds", "verdict", "stable", "hold_ratio"):
        assert fuzzed_summary.get(key) == whole.get(key), key
    assert any("were left out" in text for text in fuzzed_summary["recording"]["missing"])
    recording = open_recordings([writer.path])
    document = RecordingDocument(recording, lambda: judged_recording(recording))
    document.wait()
    facts = document.about()
    assert not facts.get("fault")
    assert facts["read"] == 1.0
    assert np.isfinite(facts["length_s"])
    hub = Hub(RecordingPlayback(open_recordings([writer.path]), itertools.count(0.0, 0.5).__next__))
    hub.join(Role.OBSERVER)
    for _ in range(60):
        hub.tick()
    assert sum(hub.left_out.rejected.values()) > 0

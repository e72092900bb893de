"""The rules of change of proto/SPEC.md: what a reader of wire 1 and recording 1 takes, ignores and refuses."""

import json
from pathlib import Path
from typing import Any

import msgpack
import pytest
import zmq
from sample_recording import write_sample
from typer.testing import CliRunner

from telenano.cli.root import app
from telenano.recording.export import export_recording
from telenano.recording.mcap_scan import FORMAT
from telenano.recording.messages import LeftOut, RawChannel, RawMessage, readable
from telenano.recording.reader import Recording
from telenano.recording.rewrite import CopyWriter, merge_recordings
from telenano.recording.summary_section import quick_info
from telenano.recording.verify import verify
from telenano.runtime.bus.bus import Subscriber
from telenano.testing.filled_messages import examples
from telenano.timing.clock import SystemClock
from telenano.wire import compose, decode, encode
from telenano.wire.codec import MAX_PLAIN_BYTES, WireError, accept, decode_header, fields_of, read_header
from telenano.wire.errors import RecordingError
from telenano.wire.topics import OWN_TOPICS as TOPICS

LATER = {"tip_temperature_k": 295.1, "later": {"of": [1, "two", b"three"], "nothing": None}}
IGNORING = [topic for topic in TOPICS if topic != "session/control"]


def example_fields(topic: str, **changes: Any) -> dict[str, Any]:
    fields: dict[str, Any] = msgpack.unpackb(encode(examples(TOPICS[topic])["ordinary"]))
    return fields | changes


# --- the wire ---


@pytest.mark.parametrize("topic", IGNORING)
def test_a_key_that_is_not_known_is_ignored(topic: str) -> None:
    plain, further = msgpack.packb(example_fields(topic)), msgpack.packb(example_fields(topic, **LATER))
    # the second time is the faster way of what was seen before
    for _ in range(2):
        assert accept(topic, further) == accept(topic, plain)
        assert decode(topic, further) == decode(topic, plain)
        assert read_header(topic, further) == read_header(topic, plain)
        assert decode_header(topic, further)[0] == decode_header(topic, plain)[0]


def test_a_key_that_is_not_known_is_ignored_in_the_parts_of_a_message() -> None:
    fields = example_fields("node/health")
    further = fields | {"inputs": [row | LATER for row in fields["inputs"]]}
    assert accept("node/health", msgpack.packb(further)) == accept("node/health", msgpack.packb(fields))


def test_a_key_that_is_not_known_is_ignored_in_a_long_message() -> None:
    fields = example_fields("afm/scanline", later={f"key{number}": number for number in range(500)})
    payload = msgpack.packb(fields)
    assert len(payload) > MAX_PLAIN_BYTES
    assert accept("afm/scanline", payload) == accept("afm/scanline", msgpack.packb(example_fields("afm/scanline")))


def test_a_command_with_a_key_that_is_not_known_is_refused_by_its_name() -> None:
    with pytest.raises(WireError, match="session/control: dry_run") as caught:
        accept("session/control", msgpack.packb(example_fields("session/control", dry_run=True)))
    assert caught.value.reason == "schema"


@pytest.mark.parametrize("topic", ["afm/state", "node/health", "link/fates", "session/control"])
def test_a_key_that_is_not_known_is_not_sent(topic: str) -> None:
    with pytest.raises(WireError, match="tip_temperature_k is not known"):
        compose(topic, fields_of(decode(topic, msgpack.packb(example_fields(topic)))) | LATER, print)


@pytest.mark.parametrize("topic", TOPICS)
def test_a_later_version_is_refused_in_a_sentence_with_both(topic: str) -> None:
    known = TOPICS[topic].model.version
    later = msgpack.packb(example_fields(topic, v=known + 1, **LATER))
    for read in (accept, decode):
        with pytest.raises(WireError, match=f"version {known + 1} from .* is newer than version {known} ") as caught:
            read(topic, later)
        assert caught.value.reason == "newer_version"


def test_a_topic_that_is_not_known_is_skipped_and_counted(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/node"
    with zmq.Context() as context:
        publisher = context.socket(zmq.XPUB)
        publisher.bind(endpoint)
        subscriber = Subscriber(context, SystemClock(), {endpoint: ["afm/state"]})
        try:
            assert publisher.poll(20_000), "no subscription within 20 s"
            payload = msgpack.packb(example_fields("afm/state"))
            for topic in (b"afm/state/raw", b"afm/state"):
                publisher.send_multipart([topic, payload])
            received: list[str] = []
            while not received and subscriber.socket.poll(20_000):
                received += [taken.topic for taken in subscriber.receive()]
            assert received == ["afm/state"]
            assert subscriber.rejected == {"topic": 1}
        finally:
            subscriber.close()
            publisher.close(linger=0)


# --- recordings ---


def with_additions(folder: Path) -> Path:
    """Write a recording of a later version: a key, a channel, an attachment and metadata that are not known now."""
    source = write_sample(folder, **{"afm/state": LATER})
    target = folder / "later.mcap"
    now_ns = 1_750_000_000_000_000_000
    facts = {"topic": "afm/wobble", "site": "slave", "via": "direct", "src": "afm_node@slave", "unit": "m"}
    channel = RawChannel("afm/wobble", "msgpack", tuple(facts.items()), ("AfmWobble", "jsonschema", b"{}"))
    with CopyWriter(target) as writer:
        writer.copy_attachments_and_metadata([Recording(source)])
        writer.attach("weather.json", "application/json", b"{}", now_ns)
        writer.add_metadata("weather", {"room_k": "295"})
        for message in Recording(source).raw():
            writer.add(message)
        header = {"seq": 0, "t_ns": now_ns, "src": "afm_node@slave", "v": 1, "wobble_m": 1e-9}
        writer.add(RawMessage(channel, now_ns, now_ns, 0, msgpack.packb(header)))
    return target


def test_a_recording_with_what_is_not_known_is_read_whole(tmp_path: Path) -> None:
    path = with_additions(tmp_path)
    recording = Recording(path)
    assert recording.metadata["weather"] == {"room_k": "295"}
    assert recording.attachments["weather.json"] == b"{}"
    left_out = LeftOut()
    taken = [message.topic for message, _ in readable(recording.messages(), left_out)]
    assert {"afm/state", "recorder/gap", "session/event"} <= set(taken)
    # the message of the channel that is not known stays in the file, and is counted
    assert left_out.rejected == {"topic": 1}
    [unknown] = recording.messages(["afm/wobble"])
    assert unknown.fields()["wobble_m"] == 1e-9
    rows = [row.channel_topic for row in Recording(path).info().channels]
    assert "afm/wobble" in rows
    (unknown_topic,) = [found for found in verify([path]).findings if found.check == "schema"]
    assert (unknown_topic.level, unknown_topic.channel) == ("info", "afm/wobble")


def test_the_tools_take_a_recording_with_what_is_not_known(tmp_path: Path) -> None:
    path = with_additions(tmp_path)
    copy = tmp_path / "merged.mcap"
    assert merge_recordings([path], copy).messages == Recording(path).info().messages
    assert [message.fields()["wobble_m"] for message in Recording(copy).messages(["afm/wobble"])] == [1e-9]
    export_recording(path, tmp_path / "tables", "csv")
    assert "wobble_m" in (tmp_path / "tables" / "afm_wobble.csv").read_text(encoding="utf-8")


def test_a_recording_has_its_format(tmp_path: Path) -> None:
    assert Recording(write_sample(tmp_path)).metadata["recording"]["format"] == FORMAT == "1"


def test_a_recording_of_a_later_format_is_refused_in_a_sentence_with_both(tmp_path: Path) -> None:
    source, path = write_sample(tmp_path), tmp_path / "later.mcap"
    with CopyWriter(path) as writer:
        writer.add_metadata("recording", Recording(source).metadata["recording"] | {"format": "2"})
        for message in Recording(source).raw():
            writer.add(message)
    with pytest.raises(RecordingError, match="is a recording of format 2, and format 1 is known here"):
        Recording(path)
    assert quick_info(path) is None
    for command in (["bag", "info"], ["bag", "verify"]):
        result = CliRunner().invoke(app, [*command, str(path)])
        assert result.exit_code != 0
        assert "is a recording of format 2, and format 1 is known here: update telenano" in result.output


def test_a_recording_without_a_format_is_of_the_first(tmp_path: Path) -> None:
    source, path = write_sample(tmp_path), tmp_path / "first.mcap"
    facts = {key: text for key, text in Recording(source).metadata["recording"].items() if key != "format"}
    with CopyWriter(path) as writer:
        writer.add_metadata("recording", facts)
        for message in Recording(source).raw():
            writer.add(message)
    assert json.dumps(facts) == json.dumps(Recording(path).metadata["recording"])
    assert Recording(path).info().messages == Recording(source).info().messages

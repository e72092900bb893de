"""Exports, read back with the tools that they are made for."""

import json
import tracemalloc
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from recorder_samples import EPOCH_NS, NODE, haptic_state, sample

from telenano.recording.channel_filter import Selection
from telenano.recording.export import export_recording, plain_schema
from telenano.recording.quantities import quantity
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.records import REJECTED_TOPIC
from telenano.recording.tables import line
from telenano.recording.writer import RecordingWriter
from telenano.testing import HEIGHTS_M, hand_recording, rich_recording
from telenano.testing.filled_messages import examples
from telenano.wire import encode
from telenano.wire.errors import ConfigError, RecordingError
from telenano.wire.messages import AfmScanline
from telenano.wire.schema import json_schema
from telenano.wire.topics import OWN_TOPICS as TOPICS


@pytest.fixture
def rich(tmp_path: Path) -> Path:
    return rich_recording(tmp_path)


def test_a_quantity_in_a_name_has_its_unit_in_the_contract() -> None:
    units = {"m": "m", "n": "N", "s": "s", "ns": "ns", "j": "J", "w": "W", "rad": "rad", "percent": "%"}
    for topic, row in TOPICS.items():
        for name in row.model.__struct_fields__:
            expected = units.get(name.rpartition("_")[2]) if "_per_" not in name and "sqrt" not in name else None
            if expected is not None:
                assert quantity(topic, name).unit.startswith(expected), (topic, name)


def test_what_matches_nothing_is_an_error(rich: Path, tmp_path: Path) -> None:
    near = r"has no channel haptic: did you mean haptic/state\? Known are afm/scanline"
    with pytest.raises(RecordingError, match=near):
        export_recording(rich, tmp_path / "x", "mcap-json", Selection.of(["haptic"]))
    assert not (tmp_path / "x").exists()


def test_the_json_recording_is_read_by_the_reference_reader(rich: Path, tmp_path: Path) -> None:
    target = tmp_path / "viewer.mcap"
    export_recording(rich, target, "mcap-json")
    with target.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        rows = list(reader.iter_messages())
        assert [attachment.name for attachment in reader.iter_attachments()] == ["site.yaml"]
    assert len(rows) == 41
    for schema, channel, message in rows:
        assert channel.message_encoding == "json"
        assert schema is not None
        assert schema.encoding == "jsonschema"
        described = json.loads(schema.data)
        assert described["type"] == "object"
        payload = json.loads(message.data)
        assert set(payload) <= set(described["properties"])
        assert obeys(payload, described), channel.topic
    forward = [json.loads(message.data) for _, channel, message in rows if channel.topic == "teleop/forward@slave"]
    assert [fields.get("wave_sqrt_w") for fields in forward] == [
        [0.0, 0.0, 0.5] if seq == 3 else None for seq in range(10)
    ]
    assert not any("energy_j" in fields for fields in forward)
    hand = [json.loads(message.data) for _, channel, message in rows if channel.topic == "haptic/state"]
    assert [fields["position_m"] for fields in hand] == [list(haptic_state(seq).position_m) for seq in range(10)]
    scan = [json.loads(message.data) for _, channel, message in rows if channel.topic == "afm/scanline"]
    assert scan[3]["height_m"] == (HEIGHTS_M * 3).tolist()
    assert scan[3]["amplitude_m"] == (HEIGHTS_M * 3).tolist()
    (rejected,) = [json.loads(message.data) for _, channel, message in rows if channel.topic == REJECTED_TOPIC]
    assert rejected["frames"] == ["AP8="]


def obeys(value: Any, schema: dict[str, Any]) -> bool:
    """Say whether a value is what a plain schema describes: nothing is required, nothing may be null."""
    kinds = {"number": (int, float), "integer": int, "string": str, "boolean": bool, "array": list, "object": dict}
    kind = schema.get("type")
    if kind is None:
        return value is not None
    if not isinstance(value, kinds[kind]) or (kind in ("number", "integer") and isinstance(value, bool)):
        return False
    if kind == "array":
        return all(obeys(part, schema["items"]) for part in value)
    parts = schema.get("properties", {})
    return kind != "object" or all(obeys(part, parts.get(key, {})) for key, part in value.items())


@pytest.mark.parametrize("topic", list(TOPICS))
def test_every_message_obeys_the_schema_that_viewers_get(topic: str, tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    found = examples(TOPICS[topic])
    channel = writer.channel(topic, found["minimal"].src, "master")
    for seq, message in enumerate(found.values()):
        writer.write(channel, EPOCH_NS + seq, EPOCH_NS, seq, encode(message))
    writer.finish()
    export_recording(writer.path, tmp_path / "viewer.mcap", "mcap-json")
    with (tmp_path / "viewer.mcap").open("rb") as file:
        rows = list(make_reader(file).iter_messages())
    assert len(rows) == len(found)
    for schema, _, message in rows:
        assert schema is not None
        assert obeys(json.loads(message.data), json.loads(schema.data))


def test_the_check_of_the_schema_can_fail() -> None:
    schema = {"type": "object", "properties": {"a": {"type": "array", "items": {"type": "number"}}}}
    assert obeys({"a": [1.0, 2]}, schema)
    for wrong in ({"a": None}, {"a": [[1.0]]}, {"a": [True]}, {"a": 1.0}, []):
        assert not obeys(wrong, schema)


@pytest.mark.parametrize("topic", list(TOPICS))
def test_the_schema_for_viewers_is_plain(topic: str) -> None:
    def check(node: Any) -> None:
        assert not {"$ref", "$defs", "anyOf", "prefixItems", "allOf"} & set(node)
        assert node["type"] in ("object", "array", "number", "integer", "string", "boolean")
        for part in node.get("properties", {}).values():
            check(part)
        if node["type"] == "array":
            check(node["items"])

    model = TOPICS[topic].model
    schema = plain_schema(json_schema(model))
    check(schema)
    assert set(schema["properties"]) == set(model.__struct_fields__)


@pytest.mark.parametrize("kind", ["mcap-json"])
def test_each_publisher_of_a_topic_is_a_line_of_its_own_in_a_viewer(kind: str, tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    for site in ("master", "slave"):
        channel = writer.channel("law/status", f"controller@{site}", site)
        writer.write(channel, EPOCH_NS, EPOCH_NS, 0, encode(sample("law/status", 0, src=f"controller@{site}")))
    writer.finish()
    export_recording(writer.path, tmp_path / "viewer.mcap", kind)
    with (tmp_path / "viewer.mcap").open("rb") as file:
        topics = [channel.topic for _, channel, _ in make_reader(file).iter_messages()]
    assert topics == ["law/status/controller@master", "law/status/controller@slave"]


@pytest.mark.parametrize("kind", ["mcap-json"])
def test_a_viewer_draws_by_the_time_of_sending(kind: str, tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    slow = writer.channel("afm/state", "afm_node@slave", "slave")
    # a recorder that was held up takes ten messages at once, of the one publisher before the other
    sent_ns = [EPOCH_NS + 1_000_000 * number for number in range(10)]
    for number in range(0, 10, 2):
        writer.write(channel, EPOCH_NS + 10**9, sent_ns[number], number, encode(haptic_state(number)))
    for number in range(1, 10, 2):
        payload = encode(sample("afm/state", number))
        writer.write(slow, EPOCH_NS + 10**9 + number, sent_ns[number], number, payload)
    writer.finish()
    export_recording(writer.path, tmp_path / "viewer.mcap", kind)
    with (tmp_path / "viewer.mcap").open("rb") as file:
        found = [message.log_time for _, _, message in make_reader(file).iter_messages(log_time_order=False)]
    assert found == sent_ns


def test_a_viewer_gets_the_unit_of_a_part_that_is_an_array_or_may_be_absent() -> None:
    parts = plain_schema(json_schema(AfmScanline))["properties"]
    assert parts["height_m"]["description"].endswith("[m]")
    assert "[rad]" in parts["phase_rad"]["description"]


def test_nothing_is_overwritten(rich: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="already exists"):
        export_recording(rich, tmp_path, "mcap-json")


def test_lines_are_json_with_the_facts_of_the_record(rich: Path) -> None:
    found = [json.loads(json.dumps(line(message))) for message in Recording(rich).messages(["haptic/state"])]
    assert found[2]["seq"] == 2
    assert found[2]["log_ns"] == EPOCH_NS + 2
    assert found[2]["message"]["mode"] == haptic_state(2).mode


def test_what_is_not_understood_is_given_as_it_is(tmp_path: Path) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    writer.write(hand, EPOCH_NS, 0, 0, b"\x81\xa1a\x01")
    writer.finish()
    (message,) = Recording(writer.path).messages()
    assert message.plain() == {"a": 1}
    assert AfmScanline.version >= 1


@pytest.mark.check("takes 1.2 s")
def test_the_memory_of_an_export_does_not_grow_with_the_length(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("telenano.recording.rewrite._CHUNK_BYTES", 8192)
    peaks = []
    for number, messages in enumerate((250, 250, 1250)):
        path = hand_recording(tmp_path / f"from{number}", messages)
        # the first is for what is imported and kept
        if number:
            tracemalloc.start()
        try:
            export_recording(path, tmp_path / f"to{number}", "mcap-json")
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert 0 < peaks[2] < 1.5 * peaks[1]


def test_a_reader_that_keeps_numbers_as_doubles_has_each_time_in_digits(rich: Path, tmp_path: Path) -> None:
    target = tmp_path / "viewer.mcap"
    export_recording(rich, target, "mcap-json", Selection.of(["haptic/state"], []))
    with target.open("rb") as stream:
        rows = [(schema, json.loads(message.data)) for schema, _, message in make_reader(stream).iter_messages()]
    [schema] = {schema.data for schema, _ in rows if schema is not None}
    assert json.loads(schema)["properties"]["t_ns_text"]["type"] == "string"
    for seq, (_, fields) in enumerate(rows):
        assert int(fields["t_ns_text"]) == fields["t_ns"] == haptic_state(seq).t_ns
        assert int(fields["answered_t_ns_text"]) == fields["answered_t_ns"]
    assert any(int(float(fields["t_ns"])) != int(fields["t_ns_text"]) for _, fields in rows)


@pytest.mark.parametrize("kind", ["parquet", "csv", "hdf5"])
def test_a_format_of_a_package_that_is_not_there_is_named(
    rich: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr("telenano.settings.plugins.installed", lambda kind: {})
    with pytest.raises(ConfigError, match=rf"^the format {kind} is in the package telenano-bridges\[tables\]: "):
        export_recording(rich, tmp_path / "x", kind)
    assert not (tmp_path / "x").exists()


def test_a_format_that_nothing_has_is_refused_with_those_there_are(rich: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"'parkay' is not a format.*; known are mcap-json, .*csv"):
        export_recording(rich, tmp_path / "x", "parkay")

"""Exports, read back with the tools that they are made for."""

import csv
import json
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow.parquet as parquet
import pytest
from mcap.reader import make_reader
from recorder_samples import EPOCH_NS, NODE, haptic_state, sample
from wire_contract import examples

from telenano.recording.channel_filter import Selection
from telenano.recording.export import export_recording, plain_schema
from telenano.recording.messages import RawChannel, RawMessage
from telenano.recording.quantities import quantity
from telenano.recording.reader import Recording
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.records import REJECTED_TOPIC, RejectedRecord
from telenano.recording.rewrite import CopyWriter
from telenano.recording.tables import line, plain, typed_columns
from telenano.recording.writer import RecordingWriter
from telenano.wire import TOPICS, encode
from telenano.wire.errors import ConfigError, RecordingError
from telenano.wire.messages import AfmScanline, Array
from telenano.wire.schema import json_schema

HEIGHTS = np.array([1e-9, -2.5e-10, 3e-12])


@pytest.fixture
def rich(tmp_path: Path) -> Path:
    """A recording with every kind of field: vectors, flags, text, arrays, maps, parts that may be nil."""
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    writer.attach("site.yaml", "application/yaml", b"nodes: {}\n", EPOCH_NS)
    writer.add_metadata("versions", {"python": "3"})
    hand = writer.channel("haptic/state", "haptic_node@master", "master")
    forward = writer.channel("teleop/forward", "controller@master", "slave")
    lines = writer.channel("afm/scanline", "afm_node@slave", "slave")
    event = writer.channel("session/event", "afm_node@slave", "slave")
    for seq in range(10):
        writer.write(hand, EPOCH_NS + seq, seq, seq, encode(haptic_state(seq)))
        wave = (0.0, 0.0, 0.5) if seq == 3 else None
        message = sample("teleop/forward", seq, src="controller@master", wave_sqrt_w=wave, energy_j=None)
        writer.write(forward, EPOCH_NS + seq, message.t_ns, seq, encode(message))
        heights, wide = Array.from_numpy(HEIGHTS * seq), Array.from_numpy((HEIGHTS * seq).reshape(1, 3))
        scan = sample("afm/scanline", seq, src="afm_node@slave", height_m=heights, amplitude_m=wide)
        writer.write(lines, EPOCH_NS + seq, scan.t_ns, seq, encode(scan))
        message = sample("session/event", seq, src="afm_node@slave", data={"force_n": 1.5, f"k{seq}": "x"})
        writer.write(event, EPOCH_NS + seq, message.t_ns, seq, encode(message))
    rejected = RejectedRecord(
        reason="malformed", text="t", publisher="afm_node@slave", size_bytes=2, frames=(b"\x00\xff",)
    )
    writer.write_rejected(EPOCH_NS, rejected)
    writer.finish()
    return writer.path


def test_parquet_holds_every_digit(rich: Path, tmp_path: Path) -> None:
    target = tmp_path / "tables"
    copied = export_recording(rich, target, "parquet")
    assert copied.messages == 41
    hand = parquet.read_table(target / "haptic_state.parquet").to_pydict()
    assert hand["position_m.2"] == [haptic_state(seq).position_m[2] for seq in range(10)]
    assert hand["limited"] == [seq % 2 == 1 for seq in range(10)]
    forward = parquet.read_table(target / "teleop_forward@slave.parquet").to_pydict()
    assert forward["wave_sqrt_w.2"] == [0.5 if seq == 3 else None for seq in range(10)]
    scan = parquet.read_table(target / "afm_scanline.parquet").to_pydict()
    assert scan["height_m"] == [(HEIGHTS * seq).tolist() for seq in range(10)]
    event = parquet.read_table(target / "session_event.parquet").to_pydict()
    assert json.loads(event["data"][4]) == {"force_n": 1.5, "k4": "x"}


def test_pandas_has_topic_and_units_of_a_parquet_file_in_its_attrs(rich: Path, tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    export_recording(rich, tmp_path / "out", "parquet")
    attrs = pandas.read_parquet(next((tmp_path / "out").glob("haptic*state*.parquet"))).attrs
    assert attrs["topic"] == "haptic/state"
    assert attrs["units"]["operator_force_n.2"] == "N"
    assert attrs["units"]["position_m.0"] == "m"


def test_csv_holds_every_digit(rich: Path, tmp_path: Path) -> None:
    export_recording(rich, tmp_path / "csv", "csv", Selection.of(["haptic/*"]))
    names = {path.name for path in (tmp_path / "csv").iterdir()}
    assert names == {"columns.csv", "haptic_state.csv", "metadata.json", "site.yaml"}
    with (tmp_path / "csv" / "haptic_state.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["operator_force_n.2"]) for row in rows] == [
        haptic_state(seq).operator_force_n[2] for seq in range(10)
    ]
    assert [int(row["log_ns"]) for row in rows] == [EPOCH_NS + seq for seq in range(10)]


def test_hdf5_has_a_group_a_channel_and_the_attachments(rich: Path, tmp_path: Path) -> None:
    target = tmp_path / "session.h5"
    export_recording(rich, target, "hdf5")
    with h5py.File(target) as file:
        assert file["haptic/state/position_m.2"][:].tolist() == [haptic_state(seq).position_m[2] for seq in range(10)]
        assert file["haptic/state/log_ns"].dtype == np.int64
        assert file["haptic/state/limited"].dtype == np.bool_
        assert file["haptic/state/mode"].asstr()[0] == haptic_state(0).mode
        wave = file["teleop/forward@slave/wave_sqrt_w.2"][:]
        assert wave[3] == 0.5
        assert np.isnan(np.delete(wave, 3)).all()
        assert file["afm/scanline/height_m"][2].tolist() == (HEIGHTS * 2).tolist()
        assert file["attachments/site.yaml"][()].tobytes() == b"nodes: {}\n"
        assert file["metadata/versions"].attrs["python"] == "3"


def test_columns_carry_units_and_descriptions_and_where_they_are_from(rich: Path, tmp_path: Path) -> None:
    for kind in ("parquet", "csv", "hdf5"):
        export_recording(rich, tmp_path / kind, kind)
    schema = parquet.read_schema(tmp_path / "parquet" / "haptic_state.parquet")
    force = schema.field("operator_force_n.2").metadata
    assert (force[b"unit"], force[b"description"][:5]) == (b"N", b"Force")
    assert json.loads(schema.metadata[b"telenano.versions"]) == {"python": "3"}
    assert schema.metadata[b"telenano.site.yaml"] == b"nodes: {}\n"
    with h5py.File(tmp_path / "hdf5") as file:
        assert file["teleop/forward@slave/position_m.2"].attrs["unit"] == "m"
        assert file["afm/scanline/height_m"].attrs["unit"] == "m"
        assert file["haptic/state/limited"].attrs["unit"] == ""
    assert json.loads((tmp_path / "csv" / "metadata.json").read_text())["versions"] == {"python": "3"}
    assert (tmp_path / "csv" / "site.yaml").read_bytes() == b"nodes: {}\n"
    with (tmp_path / "csv" / "columns.csv").open(newline="") as file:
        described = {(row["channel"], row["column"]): row for row in csv.DictReader(file)}
    assert described["teleop/forward@slave", "velocity_m_per_s.0"]["unit"] == "m/s"
    assert described["haptic/state", "log_ns"] == {
        "channel": "haptic/state", "column": "log_ns", "unit": "ns",
        "description": "Recorder's clock at the reception",
    }  # fmt: skip


def test_a_quantity_in_a_name_has_its_unit_in_the_contract() -> None:
    units = {"m": "m", "n": "N", "s": "s", "ns": "ns", "j": "J", "w": "W", "rad": "rad", "percent": "%"}
    for topic, row in TOPICS.items():
        for name in row.model.__struct_fields__:
            expected = units.get(name.rpartition("_")[2]) if "_per_" not in name and "sqrt" not in name else None
            if expected is not None:
                assert quantity(topic, name).unit.startswith(expected), (topic, name)


def test_what_matches_nothing_is_an_error(rich: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no channel that was asked for; its channels are afm/scanline"):
        export_recording(rich, tmp_path / "x", "csv", Selection.of(["haptic"]))
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
    assert scan[3]["height_m"] == (HEIGHTS * 3).tolist()
    assert scan[3]["amplitude_m"] == (HEIGHTS * 3).tolist()
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


def test_an_attachment_of_a_strangers_recording_is_written_into_the_folder_and_nowhere_else(tmp_path: Path) -> None:
    with CopyWriter(tmp_path / "s.mcap") as writer:
        facts = (("delivery", "lossless"), ("site", "slave"), ("src", "afm_node@slave"), ("topic", "new/topic"))
        channel = RawChannel("new/topic", "msgpack", facts, None)
        writer.add(RawMessage(channel, EPOCH_NS, EPOCH_NS, 0, b"\x81\xa1a\x01"))
        for name in ("../outside", "/outside", "columns.csv"):
            writer.attach(name, "text/plain", b"not ours", EPOCH_NS)
    export_recording(tmp_path / "s.mcap", tmp_path / "csv", "csv")
    assert {path.name for path in tmp_path.iterdir()} == {"s.mcap", "csv"}
    assert (tmp_path / "csv" / "columns.csv").read_text().startswith("channel,column")


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
    for kind in ("parquet", "csv", "hdf5", "mcap-json"):
        with pytest.raises(RecordingError, match="already exists"):
            export_recording(rich, tmp_path, kind)


def test_a_package_that_is_not_there_is_named(rich: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    with pytest.raises(ConfigError, match=r"hdf5 needs the package h5py: pip install .*\[export\]'"):
        export_recording(rich, tmp_path / "x.h5", "hdf5")


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
    assert plain(message) == {"a": 1}
    assert AfmScanline.version >= 1


def exported(path: Path, target: Path, kind: str) -> dict[str, dict[str, list[Any]]]:
    """Export a recording and return its tables, by name and column."""
    export_recording(path, target, kind)
    tables: dict[str, dict[str, list[Any]]] = {}
    if kind == "hdf5":
        with h5py.File(target) as file:
            for topic in ("haptic/state", "teleop/forward@slave", "afm/scanline", "session/event"):
                tables[topic] = {name: [str(value) for value in data[()]] for name, data in file[topic].items()}
        return tables
    for each in target.glob(f"*_*.{kind}"):
        if kind == "parquet":
            tables[each.stem] = parquet.read_table(each).to_pydict()
        else:
            with each.open(newline="", encoding="utf-8") as file:
                head, *rows = csv.reader(file)
            tables[each.stem] = {name: list(found) for name, found in zip(head, zip(*rows, strict=True), strict=True)}
    return tables


@pytest.mark.parametrize("kind", ["csv", "parquet", "hdf5"])
def test_tables_written_in_batches_are_those_written_at_once(
    rich: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    at_once = exported(rich, tmp_path / "once", kind)
    assert len(at_once) >= 4
    # the vector that only the fourth message has is not in the first batch
    monkeypatch.setattr("telenano.recording.table_batches._MOST_ROWS", 3)
    assert exported(rich, tmp_path / "batches", kind) == at_once
    # each channel is written as soon as anything waits
    monkeypatch.setattr("telenano.recording.table_batches._MOST_WAITING", 1)
    assert exported(rich, tmp_path / "singly", kind) == at_once


def test_an_export_holds_a_bounded_number_of_messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=tmp_path))
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    for seq in range(1000):
        writer.write(channel, EPOCH_NS + seq, EPOCH_NS + seq, seq, encode(haptic_state(seq)))
    writer.finish()
    lengths: list[int] = []

    def counted(messages: Any) -> Any:
        lengths.append(len(messages))
        return typed_columns(messages)

    monkeypatch.setattr("telenano.recording.table_batches._MOST_ROWS", 64)
    monkeypatch.setattr("telenano.recording.table_batches.typed_columns", counted)
    export_recording(writer.path, tmp_path / "parquet", "parquet")
    assert (max(lengths), sum(lengths)) == (64, 1000)


def _hand(folder: Path, messages: int) -> Path:
    """Write the hand at 100 Hz in chunks of 8 kB."""
    writer = RecordingWriter.create(NODE, RecorderConfig(directory=folder, chunk_size_bytes=8192))
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    for seq in range(messages):
        t_ns = EPOCH_NS + seq * 10_000_000
        writer.write(channel, t_ns, t_ns, seq, encode(haptic_state(seq, t_ns=t_ns)))
    writer.finish()
    return writer.path


def test_rows_are_written_in_large_groups_and_a_file_of_many_is_followed_by_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = _hand(tmp_path, 1000)
    export_recording(path, tmp_path / "once", "parquet")
    once = parquet.ParquetFile(tmp_path / "once" / "haptic_state.parquet")
    # what a file says of a row group is in memory until it is closed
    assert once.metadata.num_row_groups == 1
    monkeypatch.setattr("telenano.recording.table_batches._MOST_ROWS", 10)
    monkeypatch.setattr("telenano.recording.parquet_tables._MOST_ROWS", 100)
    monkeypatch.setattr("telenano.recording.parquet_tables._MOST_PARTS", 4 * once.metadata.num_columns)
    export_recording(path, tmp_path / "parts", "parquet")
    names = [f"haptic_state{part}.parquet" for part in ("", ".2", ".3")]
    assert sorted(each.name for each in (tmp_path / "parts").iterdir()) == sorted(names)
    files = [parquet.ParquetFile(tmp_path / "parts" / name) for name in names]
    assert [file.metadata.num_row_groups for file in files] == [4, 4, 2]
    rows = [row for file in files for row in file.read().to_pylist()]
    assert rows == once.read().to_pylist()
    assert all(file.schema_arrow.equals(once.schema_arrow, check_metadata=True) for file in files)


@pytest.mark.parametrize("kind", ["csv", "parquet", "mcap-json"])
def test_the_memory_of_an_export_does_not_grow_with_the_length(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr("telenano.recording.table_batches._MOST_ROWS", 50)
    monkeypatch.setattr("telenano.recording.parquet_tables._MOST_ROWS", 150)
    monkeypatch.setattr("telenano.recording.rewrite._CHUNK_BYTES", 8192)
    peaks = []
    for number, messages in enumerate((250, 250, 1250)):
        path = _hand(tmp_path / f"from{number}", messages)
        # the first is for what is imported and kept
        if number:
            tracemalloc.start()
        try:
            export_recording(path, tmp_path / f"to{number}", kind)
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


def test_a_recording_with_journals_becomes_tables_whose_times_are_whole(
    recording_of: Callable[[str], Path], tmp_path: Path
) -> None:
    export_recording(recording_of("fig12_wave"), tmp_path / "tables", "parquet")
    parquet = pytest.importorskip("pyarrow.parquet")
    (journal,) = (parquet.read_table(path) for path in (tmp_path / "tables").glob("*journal*.parquet"))
    times = journal["time_ns"].to_pylist()[0]
    assert all(isinstance(time_ns, int) for time_ns in times)
    assert times == sorted(times)

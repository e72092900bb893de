"""Tables of recordings, read back with the tools that they are made for."""

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

from telenano.recording import FileSettings, RecordingWriter, Selection, columns_of, export_recording
from telenano.testing import EPOCH_NS, HEIGHTS_M, foreign_recording, hand_recording, hand_state, rich_recording
from telenano.wire import RecordingError, encode


@pytest.fixture
def rich(tmp_path: Path) -> Path:
    return rich_recording(tmp_path)


def test_parquet_holds_every_digit(rich: Path, tmp_path: Path) -> None:
    target = tmp_path / "tables"
    copied = export_recording(rich, target, "parquet")
    assert copied.messages == 41
    hand = parquet.read_table(target / "haptic_state.parquet").to_pydict()
    assert hand["position_m.2"] == [hand_state(seq).position_m[2] for seq in range(10)]
    assert hand["limited"] == [seq % 2 == 1 for seq in range(10)]
    forward = parquet.read_table(target / "teleop_forward@slave.parquet").to_pydict()
    assert forward["wave_sqrt_w.2"] == [0.5 if seq == 3 else None for seq in range(10)]
    scan = parquet.read_table(target / "afm_scanline.parquet").to_pydict()
    assert scan["height_m"] == [(HEIGHTS_M * seq).tolist() for seq in range(10)]
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
        hand_state(seq).operator_force_n[2] for seq in range(10)
    ]
    assert [int(row["log_ns"]) for row in rows] == [EPOCH_NS + seq for seq in range(10)]


def test_hdf5_has_a_group_a_channel_and_the_attachments(rich: Path, tmp_path: Path) -> None:
    target = tmp_path / "session.h5"
    export_recording(rich, target, "hdf5")
    with h5py.File(target) as file:
        assert file["haptic/state/position_m.2"][:].tolist() == [hand_state(seq).position_m[2] for seq in range(10)]
        assert file["haptic/state/log_ns"].dtype == np.int64
        assert file["haptic/state/limited"].dtype == np.bool_
        assert file["haptic/state/mode"].asstr()[0] == hand_state(0).mode
        wave = file["teleop/forward@slave/wave_sqrt_w.2"][:]
        assert wave[3] == 0.5
        assert np.isnan(np.delete(wave, 3)).all()
        assert file["afm/scanline/height_m"][2].tolist() == (HEIGHTS_M * 2).tolist()
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


def test_an_attachment_of_a_strangers_recording_is_written_into_the_folder_and_nowhere_else(tmp_path: Path) -> None:
    names = ("../outside", "/outside", "columns.csv")
    foreign_recording(tmp_path / "s.mcap", {name: b"not ours" for name in names})
    export_recording(tmp_path / "s.mcap", tmp_path / "csv", "csv")
    assert {path.name for path in tmp_path.iterdir()} == {"s.mcap", "csv"}
    assert (tmp_path / "csv" / "columns.csv").read_text().startswith("channel,column")


def test_nothing_is_overwritten(rich: Path, tmp_path: Path) -> None:
    for kind in ("parquet", "csv", "hdf5"):
        with pytest.raises(RecordingError, match="already exists"):
            export_recording(rich, tmp_path, kind)


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
    monkeypatch.setattr("telenano_bridges.tables._MOST_ROWS", 3)
    assert exported(rich, tmp_path / "batches", kind) == at_once
    # each channel is written as soon as anything waits
    monkeypatch.setattr("telenano_bridges.tables._MOST_WAITING", 1)
    assert exported(rich, tmp_path / "singly", kind) == at_once


def test_an_export_holds_a_bounded_number_of_messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writer = RecordingWriter.create("recorder@master", FileSettings(directory=tmp_path))
    channel = writer.channel("haptic/state", "haptic_node@master", "master")
    for seq in range(1000):
        writer.write(channel, EPOCH_NS + seq, EPOCH_NS + seq, seq, encode(hand_state(seq)))
    writer.finish()
    lengths: list[int] = []

    def counted(messages: Any) -> Any:
        lengths.append(len(messages))
        return columns_of(messages)

    monkeypatch.setattr("telenano_bridges.tables._MOST_ROWS", 64)
    monkeypatch.setattr("telenano_bridges.tables.columns_of", counted)
    export_recording(writer.path, tmp_path / "parquet", "parquet")
    assert (max(lengths), sum(lengths)) == (64, 1000)


def test_rows_are_written_in_large_groups_and_a_file_of_many_is_followed_by_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = hand_recording(tmp_path, 1000)
    export_recording(path, tmp_path / "once", "parquet")
    once = parquet.ParquetFile(tmp_path / "once" / "haptic_state.parquet")
    # The writer holds the metadata of every row group in memory until the file is closed.
    assert once.metadata.num_row_groups == 1
    monkeypatch.setattr("telenano_bridges.tables._MOST_ROWS", 10)
    monkeypatch.setattr("telenano_bridges.tables._GROUP_ROWS", 100)
    monkeypatch.setattr("telenano_bridges.tables._MOST_PARTS", 4 * once.metadata.num_columns)
    export_recording(path, tmp_path / "parts", "parquet")
    names = [f"haptic_state{part}.parquet" for part in ("", ".2", ".3")]
    assert sorted(each.name for each in (tmp_path / "parts").iterdir()) == sorted(names)
    files = [parquet.ParquetFile(tmp_path / "parts" / name) for name in names]
    assert [file.metadata.num_row_groups for file in files] == [4, 4, 2]
    rows = [row for file in files for row in file.read().to_pylist()]
    assert rows == once.read().to_pylist()
    assert all(file.schema_arrow.equals(once.schema_arrow, check_metadata=True) for file in files)


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_the_memory_of_an_export_does_not_grow_with_the_length(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr("telenano_bridges.tables._MOST_ROWS", 50)
    monkeypatch.setattr("telenano_bridges.tables._GROUP_ROWS", 150)
    peaks = []
    for number, messages in enumerate((250, 250, 1250)):
        path = hand_recording(tmp_path / f"from{number}", messages)
        # the first is for what is imported and kept
        if number:
            tracemalloc.start()
        try:
            export_recording(path, tmp_path / f"to{number}", kind)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
    assert 0 < peaks[2] < 1.5 * peaks[1]


def test_a_recording_with_journals_becomes_tables_whose_times_are_whole(
    recording_of: Callable[[str], Path], tmp_path: Path
) -> None:
    export_recording(recording_of("wave"), tmp_path / "tables", "parquet")
    parquet = pytest.importorskip("pyarrow.parquet")
    (journal,) = (parquet.read_table(path) for path in (tmp_path / "tables").glob("*journal*.parquet"))
    times = journal["time_ns"].to_pylist()[0]
    assert all(isinstance(time_ns, int) for time_ns in times)
    assert times == sorted(times)

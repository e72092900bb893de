"""Recordings for other tools: Parquet, CSV, HDF5 tables, and MCAP with JSON or protobuf payloads for viewers."""

import csv
import importlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from proto import TOPICS
from proto.errors import ConfigError, RecordingError
from proto.messages import Record
from recording.channel_filter import ALL, Selection
from recording.mcap_scan import Damage, describe_damage
from recording.messages import RawChannel, RawMessage, RecordedChannel
from recording.protobuf_export import ProtobufMessage
from recording.quantities import quantity
from recording.reader import Recording
from recording.records import RECORDS
from recording.rewrite import CopyResult, CopyWriter
from recording.sender_time import SenderClock, SenderOrder
from recording.tables import plain, table
from recording.whole_files import whole_file, whole_folder

Format = Literal["parquet", "csv", "hdf5", "mcap-json", "mcap-protobuf"]
Columns = dict[str, list[Any]]


def export_recording(source: Path, target: Path, kind: Format, selection: Selection = ALL) -> CopyResult:
    """Write the chosen channels of a recording in another format.

    `parquet` and `csv` make a folder with a file for each channel, `hdf5` a file with a group for each, `mcap-json` and
    `mcap-protobuf` an MCAP file, in which a topic of several publishers has a channel for each, and messages the time
    of their sending. Columns carry unit and description: as metadata of a field (`parquet`), as attributes of a dataset
    (`hdf5`), in the table `columns.csv` (`csv`), in the schema (`mcap-json`, `mcap-protobuf`). Attachments and metadata
    of the recording, so scenario, versions and seeds, go along: as files beside the tables (`csv`), else inside.

    It has its name only when it is complete, and nothing is left of one that is not.

    Raises RecordingError when nothing is selected, the source is not a recording, or the target exists or cannot be
    written, ConfigError when a package that the format needs is not installed.
    """
    recording = Recording(source)
    if selection is not ALL and not any(map(selection, recording.channels)):
        known = ", ".join(sorted({channel.channel_topic for channel in recording.channels})) or "none"
        raise RecordingError(f"{source}: has no channel that was asked for; its channels are {known}")
    try:
        return _export(recording, target, kind, selection)
    except FileExistsError as error:
        # where a file stands in the place of its folder, that is what exists
        reason = "already exists and is not overwritten" if target.exists() else f"cannot be created: {error.strerror}"
        raise RecordingError(f"{target}: {reason}") from error
    except OSError as error:
        # HDF5 has a text of its own, of several lines
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise RecordingError(f"{target}: cannot be written: {reason}") from error


def _export(recording: Recording, target: Path, kind: Format, selection: Selection) -> CopyResult:
    if kind in ("mcap-json", "mcap-protobuf"):
        return _export_mcap(recording, target, selection, _as_json if kind == "mcap-json" else _as_protobuf)
    skipped = describe_damage(recording.structural_damage)
    if kind == "hdf5":
        h5py = _package("h5py", "hdf5")
        with whole_file(target, replace=False) as file:
            total = _export_hdf5(h5py, recording, file, selection)
        return CopyResult(path=str(target), messages=total, skipped=skipped)
    write = _write_csv if kind == "csv" else _parquet_writer(recording)
    with whole_folder(target) as folder:
        total = _export_tables(recording, folder, kind, selection, write)
    return CopyResult(path=str(target), messages=total, skipped=skipped)


def _export_tables(
    recording: Recording, target: Path, kind: Format, selection: Selection, write: Callable[[Path, str, Columns], None]
) -> int:
    """Write a file for each channel into a folder; return the number of messages."""
    total = 0
    described: list[tuple[str, ...]] = [("channel", "column", "unit", "description")]
    for name, columns in _tables(recording, selection):
        write(target / f"{file_stem(name)}.{kind}", name, columns)
        described += [(name, column, *quantity(topic_of(name), column)) for column in columns]
        total += len(columns["log_ns"])
    if kind == "csv":
        _write_rows(target / "columns.csv", described)
        _write_origin(target, recording)
    return total


def file_stem(channel_topic: str) -> str:
    """Return a channel name in a form that is valid in a file name."""
    return channel_topic.replace("/", "_")


def plain_schema(schema: Mapping[str, Any]) -> dict[str, Any]:
    """Return a JSON Schema without references, tuples and alternatives, as viewers need it.

    Vectors become lists of numbers, optional parts are described by what they are when present (and left out when they
    are not), arrays as lists.
    """
    definitions = schema.get("$defs", {})

    def simple(node: Mapping[str, Any]) -> dict[str, Any]:
        about = {key: node[key] for key in ("description",) if key in node}
        if "$ref" in node:
            name = node["$ref"].rpartition("/")[2]
            return {**(_ARRAY if name == "Array" else simple(definitions[name])), **about}
        choices = [choice for choice in node.get("anyOf", ()) if choice.get("type") != "null"]
        if choices:
            return {**simple(choices[0]), **about}
        kind = node.get("type", "object")
        if kind == "array":
            items = node.get("prefixItems", [node.get("items", {})])[0]
            return {"type": "array", "items": simple(items) if items else {"type": "string"}, **about}
        if kind == "object":
            properties = {name: simple(part) for name, part in node.get("properties", {}).items()}
            return {"type": "object", "properties": properties, **about}
        encoding = {"contentEncoding": "base64"} if node.get("format") == "binary" else {}
        return {"type": kind, **encoding, **about}

    return {"title": schema.get("title", ""), **simple(schema)}


_ARRAY: dict[str, Any] = {"type": "array", "items": {"type": "number"}}


def _tables(recording: Recording, selection: Selection) -> Iterator[tuple[str, Columns]]:
    names = dict.fromkeys(channel.channel_topic for channel in recording.channels if selection(channel))
    for name in names:
        chosen = (found for found in recording.messages([name]) if selection(found.channel))
        columns = table(chosen)
        if columns:
            yield name, columns


def topic_of(channel_topic: str) -> str:
    """Return the topic of a channel, which may have the site of its reception after an `@`."""
    return channel_topic.partition("@")[0]


def _write_csv(path: Path, channel_topic: str, columns: Columns) -> None:
    # float repr has all digits
    _write_rows(path, [tuple(columns), *zip(*columns.values(), strict=True)])


def _write_rows(path: Path, rows: list[tuple[Any, ...]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)


def _write_origin(folder: Path, recording: Recording) -> None:
    """Write where tables of text are from: scenario, site file and what else is attached, and `metadata.json`."""
    text = json.dumps(recording.metadata, indent=2, ensure_ascii=False)
    (folder / "metadata.json").write_text(text + "\n", encoding="utf-8")
    for name, data in recording.attachments.items():
        # a recording may come from anybody: no folder but this one
        path = folder / file_stem(name).replace("\\", "_").lstrip(".")
        if not path.exists():
            path.write_bytes(data)


def _parquet_writer(recording: Recording) -> Callable[[Path, str, Columns], None]:
    arrow, parquet = _package("pyarrow", "parquet"), _package("pyarrow.parquet", "parquet")
    origin = {f"telenano.{name}": json.dumps(facts) for name, facts in recording.metadata.items()}
    origin |= {f"telenano.{name}": data.decode(errors="replace") for name, data in recording.attachments.items()}

    def write(path: Path, channel_topic: str, columns: Columns) -> None:
        made = arrow.table(columns)
        for place, name in enumerate(made.column_names):
            facts = quantity(topic_of(channel_topic), name)._asdict()
            made = made.set_column(place, made.field(place).with_metadata(facts), made.column(place))
        parquet.write_table(made.replace_schema_metadata(origin), path, compression="zstd")

    return write


def _export_hdf5(h5py: Any, recording: Recording, target: Path, selection: Selection) -> int:
    """Write a group for each channel into a file; return the number of messages."""
    total = 0
    with h5py.File(target, "x") as file:
        for name, facts in recording.metadata.items():
            file.create_group(f"metadata/{name}").attrs.update(facts)
        for name, data in recording.attachments.items():
            file[f"attachments/{name}"] = np.void(data)
        for name, columns in _tables(recording, selection):
            group = file.create_group(name)
            group.attrs["topic"] = topic_of(name)
            total += len(columns["log_ns"])
            for column, values in columns.items():
                _write_dataset(h5py, group, column, values)
                group[column].attrs.update(quantity(topic_of(name), column)._asdict())
    return total


def _write_dataset(h5py: Any, group: Any, name: str, values: list[Any]) -> None:
    present = [value for value in values if value is not None]
    first = present[0] if present else 0.0
    if isinstance(first, str):
        group.create_dataset(name, data=[value or "" for value in values], dtype=h5py.string_dtype())
    elif isinstance(first, list):
        data = group.create_dataset(name, (len(values),), dtype=h5py.vlen_dtype(np.float64))
        for number, value in enumerate(values):
            data[number] = np.asarray(value or [], dtype=np.float64)
    elif len(present) < len(values):
        group.create_dataset(name, data=np.array([np.nan if value is None else value for value in values], dtype=float))
    else:
        group.create_dataset(name, data=np.array(values), compression="gzip", shuffle=True)


class _Payload(NamedTuple):
    """How the messages of a channel are written: encoding, schema, and a function of the JSON values of one."""

    encoding: str
    schema: tuple[str, str, bytes]
    encode: Callable[[dict[str, Any]], bytes]


def _export_mcap(
    recording: Recording, target: Path, selection: Selection, payload_of: Callable[[str], _Payload]
) -> CopyResult:
    skipped: list[Damage] = list(recording.structural_damage)
    refused: list[str] = []
    # viewers draw by log_time, and against the recorder's a ramp is a staircase
    select = partial(recording.select, report=skipped.append)
    sent = SenderOrder(recording, selection, SenderClock(recording), select=select, ends=True)
    publishers = Counter(name for name, _ in {(channel.channel_topic, channel.src) for channel in recording.channels})
    payloads = {channel.topic: payload_of(channel.topic) for channel in recording.channels if selection(channel)}
    channels: dict[RecordedChannel, RawChannel] = {}
    with CopyWriter(target, profile="") as writer:
        writer.copy_attachments_and_metadata([recording])
        for sent_ns, _, message in sent:
            payload = payloads[message.topic]
            if message.channel not in channels:
                several = publishers[message.channel_topic] > 1
                channels[message.channel] = _viewer_channel(message.channel, payload, several)
            try:
                data = payload.encode(plain(message))
            except (TypeError, ValueError) as error:
                refused.append(f"{message.channel_topic}, seq {message.seq}: {error}")
                continue
            writer.add(RawMessage(channels[message.channel], sent_ns, message.publish_ns, message.seq, data))
    return CopyResult(path=str(target), messages=writer.messages, skipped=(*describe_damage(skipped), *refused))


def _viewer_channel(channel: RecordedChannel, payload: _Payload, several: bool) -> RawChannel:
    # viewers draw a channel as one line, whoever sent its messages
    name = f"{channel.channel_topic}/{channel.src}" if several else channel.channel_topic
    facts = {"topic": channel.topic, "site": channel.site, "via": channel.via, "src": channel.src}
    return RawChannel(name, payload.encoding, tuple(sorted(facts.items())), payload.schema)


def _as_json(topic: str) -> _Payload:
    model = _model_of(topic)
    schema: dict[str, Any] = (
        {"type": "object", "properties": {}} if model is None else plain_schema(model.model_json_schema())
    )
    name = topic if model is None else f"telenano.{model.__name__}"

    def encode(fields: dict[str, Any]) -> bytes:
        return json.dumps(fitted(fields, schema), separators=(",", ":")).encode()

    return _Payload("json", (name, "jsonschema", json.dumps(schema).encode()), encode)


def _as_protobuf(topic: str) -> _Payload:
    model = _model_of(topic)
    if model is None:
        unknown = ProtobufMessage("Unknown", {"properties": {"json": {"type": "object"}}})
        described = (unknown.name, "protobuf", unknown.descriptor_set)
        return _Payload("protobuf", described, lambda fields: unknown.encode({"json": fields}))
    message = ProtobufMessage(model.__name__, plain_schema(model.model_json_schema()))
    return _Payload("protobuf", (message.name, "protobuf", message.descriptor_set), message.encode)


def _model_of(topic: str) -> type[Record] | None:
    return RECORDS.get(topic) or (TOPICS[topic].model if topic in TOPICS else None)


def fitted(value: Any, schema: Mapping[str, Any]) -> Any:
    """Return a value as its plain schema says: without what is nil, and an array of any shape as one list."""
    if isinstance(value, dict):
        parts = schema.get("properties", {})
        return {key: fitted(part, parts.get(key, {})) for key, part in value.items() if part is not None}
    if schema.get("type") != "array":
        return value
    if schema["items"].get("type") in ("number", "integer"):
        return list(_elements(value))
    return [fitted(part, schema["items"]) for part in value]


def _elements(value: Any) -> Iterator[Any]:
    if isinstance(value, list):
        for part in value:
            yield from _elements(part)
    else:
        yield value


def _package(name: str, format_name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise ConfigError(f"{format_name} needs the package {package}: pip install 'telenano[export]'") from error

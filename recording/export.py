"""Recordings for other tools: Parquet, CSV, HDF5 tables, and MCAP with JSON payloads for Foxglove and Lichtblick."""

import csv
import importlib
import json
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from proto import TOPICS
from proto.errors import ConfigError, RecordingError
from recording.channel_filter import ALL, Selection
from recording.mcap_scan import Damage, describe_damage
from recording.messages import RawChannel, RawMessage, RecordedMessage
from recording.quantities import quantity
from recording.reader import Recording
from recording.records import RECORDS
from recording.rewrite import CopyResult, CopyWriter
from recording.tables import plain, table

Format = Literal["parquet", "csv", "hdf5", "mcap-json"]
Columns = dict[str, list[Any]]


def export_recording(source: Path, target: Path, kind: Format, selection: Selection = ALL) -> CopyResult:
    """Write the chosen channels of a recording in another format.

    `parquet` and `csv` make a folder with a file for each channel, `hdf5` a file with a group for each, `mcap-json`
    an MCAP file. Columns carry unit and description: as metadata of a field (`parquet`), as attributes of a dataset
    (`hdf5`), in the table `columns.csv` (`csv`).

    Raises RecordingError when nothing is selected, the source is not a recording, or the target exists or cannot be
    written, ConfigError when a package that the format needs is not installed.
    """
    recording = Recording(source)
    if selection is not ALL and not any(map(selection, recording.channels)):
        known = ", ".join(sorted({channel.channel_topic for channel in recording.channels})) or "none"
        raise RecordingError(f"{source}: has no channel that was asked for; its channels are {known}")
    try:
        if target.exists():
            raise RecordingError(f"{target}: already exists and is not overwritten")
        return _export(recording, target, kind, selection)
    except OSError as error:
        # HDF5 has a text of its own, of several lines
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise RecordingError(f"{target}: cannot be written: {reason}") from error


def _export(recording: Recording, target: Path, kind: Format, selection: Selection) -> CopyResult:
    if kind == "mcap-json":
        return _export_json(recording, target, selection)
    if kind == "hdf5":
        return _export_hdf5(recording, target, selection)
    write = _write_csv if kind == "csv" else _parquet_writer(recording)
    target.mkdir(parents=True)
    total = 0
    described: list[tuple[str, ...]] = [("channel", "column", "unit", "description")]
    for name, columns in _tables(recording, selection):
        write(target / f"{file_stem(name)}.{kind}", name, columns)
        described += [(name, column, *quantity(topic_of(name), column)) for column in columns]
        total += len(columns["log_ns"])
    if kind == "csv":
        _write_rows(target / "columns.csv", described)
    return CopyResult(path=str(target), messages=total, skipped=describe_damage(recording.structural_damage))


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
        if "$ref" in node:
            name = node["$ref"].rpartition("/")[2]
            return _ARRAY if name == "Array" else simple(definitions[name])
        choices = [choice for choice in node.get("anyOf", ()) if choice.get("type") != "null"]
        if choices:
            return simple(choices[0])
        kind = node.get("type", "object")
        about = {key: node[key] for key in ("description",) if key in node}
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


def _export_hdf5(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    h5py = _package("h5py", "hdf5")
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
    return CopyResult(path=str(target), messages=total, skipped=describe_damage(recording.structural_damage))


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


def _export_json(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    skipped: list[Damage] = list(recording.structural_damage)
    channels: dict[str, tuple[RawChannel, dict[str, Any]]] = {}
    with CopyWriter(target, profile="") as writer:
        writer.copy_attachments_and_metadata([recording])
        for message in recording.select(selection, report=skipped.append):
            key = f"{message.channel_topic} {message.src}"
            if key not in channels:
                channels[key] = _json_channel(message)
            channel, schema = channels[key]
            payload = json.dumps(fitted(plain(message), schema), separators=(",", ":")).encode()
            writer.add(RawMessage(channel, message.log_ns, message.publish_ns, message.seq, payload))
    return CopyResult(path=str(target), messages=writer.messages, skipped=describe_damage(skipped))


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


def _json_channel(message: RecordedMessage) -> tuple[RawChannel, dict[str, Any]]:
    channel = message.channel
    model = RECORDS.get(channel.topic) or (TOPICS[channel.topic].model if channel.topic in TOPICS else None)
    facts = {"topic": channel.topic, "site": channel.site, "via": channel.via, "src": channel.src}
    schema = {"type": "object", "properties": {}} if model is None else plain_schema(model.model_json_schema())
    name = channel.topic if model is None else f"telenano.{model.__name__}"
    described = (name, "jsonschema", json.dumps(schema).encode())
    return RawChannel(channel.channel_topic, "json", tuple(sorted(facts.items())), described), schema


def _package(name: str, format_name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = name.partition(".")[0]
        raise ConfigError(f"{format_name} needs the package {package}: pip install 'telenano[export]'") from error

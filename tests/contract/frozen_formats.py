"""Wire 1 and recording 1 as others rely on them, in `frozen_formats.json`; proto/SPEC.md has the rules of change.

`python tests/contract/frozen_formats.py` adds to the file what the rules let be added. It writes nothing, and exits 1
with a sentence for each, where something that is frozen is gone or is another.
"""

import json
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgpack
import msgspec
from mcap.reader import make_reader
from wire_contract import examples, schema_of

from telenano.recording.mcap_scan import FORMAT
from telenano.recording.provenance import write_provenance
from telenano.recording.recorder_config import RecorderConfig
from telenano.recording.records import RECORDS, GapRecord, RejectedRecord
from telenano.recording.writer import RecordingWriter
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire import encode
from telenano.wire.messages import Record
from telenano.wire.schema import json_schema
from telenano.wire.topics import OWN_TOPICS as TOPICS

FILE = Path(__file__).with_suffix(".json")
SCENARIO = Path(__file__).parents[2] / "telenano" / "settings" / "scenarios" / "fig12.yaml"
WIRE = "1"
_NS = 1_750_000_000_000_000_000
_LEFT_OUT = ("description", "title", "default", "examples", "additionalProperties", "required", "type", "properties")
Formats = dict[str, dict[str, Any]]


def formats() -> Formats:
    """Return both formats as they are now."""
    return {"wire": wire(), "recording": recording()}


def wire() -> dict[str, Any]:
    """Return the topics of the wire with the fields of their messages."""
    topics = {
        name: {
            "message": row.model.__name__,
            "version": row.model.version,
            "delivery": row.delivery,
            "over the link": row.bridged,
            "published by": list(row.publishers),
            "fields": fields_of(row.model, schema_of(row)),
        }
        for name, row in TOPICS.items()
    }
    return {"version": WIRE, "topics": topics}


def fields_of(model: type[Record], schema: Mapping[str, Any]) -> dict[str, str]:
    """Return the type of each field of a message by its path, with what it may lack: `number -10 to 10, required`."""
    found = dict(_fields(schema, schema, ""))
    # its greatest value is the version of the message, which stands beside it
    return found | ({"v": "integer from 1, required"} if "v" in found else {})


def _fields(part: Mapping[str, Any], root: Mapping[str, Any], before: str) -> Iterator[tuple[str, str]]:
    for name, field in part["properties"].items():
        presence = "required" if name in part["required"] else "may be absent"
        yield f"{before}{name}", f"{_type(field, root)}, {presence}"
        for choice in (field, *field.get("anyOf", ())):
            record, mark = (choice.get("items", {}), "[]") if "items" in choice else (choice, "")
            if "$ref" in record:
                below = root["$defs"][record["$ref"].rpartition("/")[2]]
                yield from _fields(below, root, f"{before}{name}{mark}.")


def _type(field: Mapping[str, Any], root: Mapping[str, Any]) -> str:
    """Return a type of JSON Schema in words, with every rule that it has."""
    if "$ref" in field:
        return f"record {field['$ref'].rpartition('/')[2]}"
    if "anyOf" in field:
        return " or ".join(_type(choice, root) for choice in field["anyOf"])
    if "prefixItems" in field:
        return f"[{', '.join(_type(item, root) for item in field['prefixItems'])}]"
    rules = {rule: value for rule, value in field.items() if rule not in _LEFT_OUT}
    of = ""
    if "items" in rules:
        of = f" of {_type(rules.pop('items'), root)}"
    elif isinstance(field.get("additionalProperties"), dict):
        of = f" of {_type(field['additionalProperties'], root)}"
    return " ".join([field["type"] + of, *(f"{rule} {json.dumps(value)}" for rule, value in sorted(rules.items()))])


def recording() -> dict[str, Any]:
    """Return what a recording that is written now has, as the library of MCAP reads it."""
    with tempfile.TemporaryDirectory() as folder:
        path = write_sample(Path(folder))
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            header, summary = reader.get_header(), reader.get_summary()
            attachments = {found.name: found.media_type for found in reader.iter_attachments()}
            metadata = {found.name: sorted(found.metadata) for found in reader.iter_metadata()}
            # what is in it depends on the packages that are installed
            metadata.pop("plugins", None)
            # the settings of the recorder are keys of a scenario, which have a rule of their own (docs/release.md)
            metadata["recording"] = [key for key in metadata["recording"] if not key.startswith("recorder ")]
            rows = {channel.topic: (schema.name, channel) for schema, channel, _ in reader.iter_messages() if schema}
    assert summary is not None
    return {
        "format": FORMAT,
        "profile": header.profile,
        "message encodings": sorted({channel.message_encoding for _, channel in rows.values()}),
        "schema encodings": sorted({schema.encoding for schema in summary.schemas.values()}),
        "channels": {name: schema for name, (schema, _) in sorted(rows.items())},
        "channel metadata": sorted({key for _, channel in rows.values() for key in channel.metadata}),
        "attachments": attachments,
        "metadata": metadata,
        "records": {topic: fields_of(model, json_schema(model)) for topic, model in RECORDS.items()},
    }


def write_sample(folder: Path, **changes: dict[str, Any]) -> Path:
    """Write a recording with a message of every topic, one that came over the link, and the recorder's own records.

    Args:
        folder: The folder that it is written to.
        changes: By topic, keys that its message has besides, or others.
    """
    config = RecorderConfig(directory=folder)
    writer = RecordingWriter.create("recorder@master", config)
    write_provenance(writer, config, DEFAULT_SITE_FILE, SCENARIO, _NS)
    for topic, row in TOPICS.items():
        message = msgspec.structs.replace(examples(row)["ordinary"], seq=0, t_ns=_NS)
        payload = msgpack.packb(msgpack.unpackb(encode(message)) | changes.get(topic, {}))
        writer.write(writer.channel(topic, message.src, message.src.partition("@")[2]), _NS, _NS, 0, payload)
        if topic == "teleop/forward":
            writer.write(writer.channel(topic, message.src, "slave"), _NS, _NS, 0, payload)
    gap = GapRecord(channel_topic="haptic/state", src="haptic_node@master", first_missing=1, last_missing=2, count=2)
    writer.write_gap(_NS, gap)
    text = RejectedRecord(reason="frames", text="3 frames", publisher="a@master", size_bytes=1, frames=(b"x",))
    writer.write_rejected(_NS, text)
    writer.finish({"state": "stopped", "note": ""})
    return writer.path


def broken(frozen: Formats, now: Formats) -> list[str]:
    """Return a sentence for each thing in which the formats of now break those that are frozen."""
    return [*_broken_wire(frozen["wire"], now["wire"]), *_broken_recording(frozen["recording"], now["recording"])]


def _broken_wire(frozen: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    if frozen["version"] != now["version"]:
        yield f"the wire is {now['version']}, and {frozen['version']} is frozen"
    for topic, row in frozen["topics"].items():
        found = now["topics"].get(topic)
        if found is None:
            yield f"topic {topic} is gone: readers of wire {frozen['version']} wait for it"
            continue
        for key in ("message", "delivery", "over the link"):
            if row[key] != found[key]:
                yield f"topic {topic}: {key} is {found[key]}, and {row[key]} is frozen"
        for node in sorted(set(row["published by"]) - set(found["published by"])):
            yield f"topic {topic}: {node} publishes it no longer"
        yield from _broken_fields(f"topic {topic}", row["fields"], found["fields"])
        has_new = bool(found["fields"].keys() - row["fields"].keys())
        if not row["version"] <= found["version"] <= row["version"] + has_new:
            yield (
                f"topic {topic}: version {found['version']}, and {row['version']} is frozen: a key that is added may "
                "raise it by one"
            )


def _broken_recording(frozen: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    for key in ("format", "profile"):
        if frozen[key] != now[key]:
            yield f"{key} of recordings is {now[key]}, and {frozen[key]} is frozen"
    for key in ("message encodings", "schema encodings"):
        if frozen[key] != now[key]:
            yield f"{key} of recordings are {', '.join(now[key])}, and {', '.join(frozen[key])} is frozen"
    for key in sorted(set(frozen["channel metadata"]) - set(now["channel metadata"])):
        yield f"channels of recordings have no {key} in their metadata"
    for kind in ("channels", "attachments"):
        for name, value in frozen[kind].items():
            if now[kind].get(name) != value:
                yield f"{kind} of recordings: {name} is {now[kind].get(name, 'gone')}, and {value} is frozen"
    for name, keys in frozen["metadata"].items():
        for key in keys:
            if key not in now["metadata"].get(name, ()):
                yield f"metadata record {name} of recordings has no {key}"
    for topic, fields in frozen["records"].items():
        if topic not in now["records"]:
            yield f"records {topic} of recordings are gone"
            continue
        yield from _broken_fields(f"record {topic}", fields, now["records"][topic])


def _broken_fields(where: str, frozen: Mapping[str, str], now: Mapping[str, str]) -> Iterator[str]:
    for path, text in frozen.items():
        if path not in now:
            yield f"{where}: field {path} is gone"
        elif now[path] != text:
            yield f"{where}: field {path} is `{now[path]}`, and `{text}` is frozen"
    new = [path for path in now if path not in frozen]
    for path in new:
        # what a new record must have is needed only where it is
        within = any(path.startswith((f"{other}.", f"{other}[].")) for other in new)
        if not within and "may be absent" not in now[path]:
            yield f"{where}: field {path} is new and `{now[path]}`: what is added may be absent"


def main(file: Path = FILE) -> int:
    """Write the file anew where nothing in it is broken; return the exit code."""
    now = formats()
    faults = broken(json.loads(file.read_text(encoding="utf-8")), now) if file.exists() else []
    for fault in faults:
        sys.stderr.write(f"{fault}\n")
    if not faults:
        file.write_text(json.dumps(now, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())

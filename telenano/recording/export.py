"""Recordings for other tools: MCAP for viewers, and the formats that packages add."""

import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from telenano.recording.channel_filter import ALL, Selection
from telenano.recording.mcap_scan import Damage, describe_damage
from telenano.recording.messages import RawChannel, RawMessage, RecordedChannel, RecordedMessage
from telenano.recording.quantities import model_of
from telenano.recording.reader import Recording
from telenano.recording.rewrite import CopyResult, CopyWriter
from telenano.recording.sender_time import SenderClock, SenderOrder
from telenano.settings import plugins
from telenano.settings.known_packages import where_it_is
from telenano.wire.errors import ConfigError, ExistsError, PackageError, RecordingError, probably_meant
from telenano.wire.schema import json_schema

# The formats of this module. Packages add others, each a function of recording, target and selection.
FORMATS = ("mcap-json",)
# With this beginning of its name, followed by the end of the files' names, an entry writes images and no recordings.
IMAGE_ENTRY = "image_"
# The form of a topic's messages for viewers: message encoding, schema (name, encoding and data), and the function that
# encodes the JSON values of one message.
Payload = tuple[str, tuple[str, str, bytes], Callable[[dict[str, Any]], bytes]]
# The key that assigns a message to a channel of the exported file.
K = TypeVar("K")
# A channel of the exported file: name, encoding, metadata, and schema (name, encoding and data).
Described = tuple[str, str, tuple[tuple[str, str], ...], tuple[str, str, bytes]]


def export_recording(source: Path, target: Path, kind: str, selection: Selection = ALL) -> CopyResult:
    """Write the selected channels of a recording in another format.

    `mcap-json` writes an MCAP file with JSON messages at their send times, one channel for each publisher of a topic.
    Its schemas hold units and descriptions; attachments and metadata of the recording (scenario, versions, seeds) are
    copied. Installed packages add formats such as `parquet`.

    The target gets its name only when it is complete; an export that fails leaves no file.

    Raises RecordingError if nothing is selected, the source is not a recording, or the target exists or cannot be
    written; ConfigError if the format is unknown or its package is not installed.
    """
    recording = Recording(source)
    selection.demand_some_of(source, recording.channels)
    try:
        return _export(recording, target, kind, selection)
    except FileExistsError as error:
        # This error also comes from a file that has the name of the target's folder.
        if target.exists():
            raise ExistsError(f"{target}: already exists and is not overwritten") from error
        raise RecordingError(f"{target}: cannot be created: {error.strerror}") from error
    except (OverflowError, ValueError) as error:
        # A file of another program may contain integers that the format cannot hold.
        raise RecordingError(f"{target}: cannot be written: {error}") from error
    except OSError as error:
        # The HDF5 library puts several lines into `strerror`, so the text comes from errno.
        reason = os.strerror(error.errno) if error.errno else str(error)
        raise RecordingError(f"{target}: cannot be written: {reason}") from error


def _export(recording: Recording, target: Path, kind: str, selection: Selection) -> CopyResult:
    if kind == "mcap-json":
        return write_viewer_mcap(recording, target, selection, _as_json)
    return _written_by_package(_of_package(kind), recording, target, kind, selection)


def plain_schema(schema: Mapping[str, Any]) -> dict[str, Any]:
    """Return a JSON Schema without references, tuples and alternatives, as viewers need it.

    Vectors and arrays become lists of numbers; an optional part has the schema that it has when present.
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


_TEXT = "_text"
_ARRAY: dict[str, Any] = {"type": "array", "items": {"type": "number"}}


def _of_package(kind: str) -> Callable[[Recording, Path, Selection], CopyResult]:
    kinds = (*FORMATS, *(name for name in plugins.installed("exports") if not name.startswith(IMAGE_ENTRY)))
    loaded = plugins.load("exports", taken=FORMATS, only=kind if kind in kinds else "")
    if kind in loaded.problems:
        raise ConfigError(loaded.problems[kind])
    if kind in loaded.found:
        export: Callable[[Recording, Path, Selection], CopyResult] = loaded.found[kind]
        return export
    if where := where_it_is(f"format {kind}"):
        raise ConfigError(where)
    raise ConfigError(f"{kind!r} is not a format{probably_meant(kind, kinds)}; known are {', '.join(kinds)}")


def _written_by_package(write: Any, recording: Recording, target: Path, kind: str, selection: Selection) -> CopyResult:
    package = plugins.installed("exports")[kind].package
    try:
        with plugins.code_of(package, OSError):
            if isinstance(done := write(recording, target, selection), CopyResult):
                return done
            fault = f"the package {package} returned {type(done).__name__}, and must return a CopyResult"
    except PackageError as error:
        fault = str(error)
    raise RecordingError(f"{target}: is not exported as {kind}: {fault}; choose another format")


def write_viewer_mcap(
    recording: Recording, target: Path, selection: Selection, payload_of: Callable[[str, Mapping[str, Any]], Payload]
) -> CopyResult:
    """Write the selected channels as MCAP for viewers, each message at its send time.

    Args:
        recording: The recording.
        target: The file to write.
        selection: Predicate of the channels to write.
        payload_of: Returns encoding, schema (name, encoding and data) and encoder of a topic from its name and the
            `plain_schema` of its messages, whose `title` is the name of the message. The schema of a topic that this
            version does not know has no title and no properties.

    Raises:
        RecordingError: The file cannot be written.
    """
    publishers = Counter(name for name, _ in {(channel.channel_topic, channel.src) for channel in recording.channels})
    topics = {channel.topic for channel in recording.channels if selection(channel)}
    payloads = {topic: payload_of(topic, _plain_schema_of(topic)) for topic in topics}

    def encode(message: RecordedMessage) -> Iterator[tuple[RecordedChannel, bytes]]:
        yield message.channel, payloads[message.topic][2](message.plain())

    def describe(channel: RecordedChannel) -> Described:
        encoding, schema, _ = payloads[channel.topic]
        # Viewers draw a channel as one line, so each publisher needs its own channel.
        several = publishers[channel.channel_topic] > 1
        name = f"{channel.channel_topic}/{channel.src}" if several else channel.channel_topic
        facts = {"topic": channel.topic, "site": channel.site, "via": channel.via, "src": channel.src}
        return name, encoding, tuple(sorted(facts.items())), schema

    return write_mcap(recording, target, selection, encode, describe)


def write_mcap(
    recording: Recording,
    target: Path,
    selection: Callable[[RecordedChannel], bool],
    encode: Callable[[RecordedMessage], Iterable[tuple[K, bytes]]],
    describe: Callable[[K], Described],
    profile: str = "",
) -> CopyResult:
    """Write the selected channels of a recording to MCAP in order of their send times.

    Args:
        recording: The recording.
        target: The file to write.
        selection: Predicate of the channels to write.
        encode: Converts a message to any number of new ones, each the key of its channel and its bytes. A message for
            which it raises TypeError, ValueError or KeyError is left out and named in the result.
        describe: Returns name, encoding, metadata and schema (name, encoding and data) of a channel from its key.
        profile: The MCAP profile that the channels follow.

    Raises:
        RecordingError: The file cannot be written.
    """
    skipped: list[Damage] = list(recording.structural_damage)
    refused: list[str] = []
    channels: dict[K, RawChannel] = {}
    # Viewers plot against log_time; against the recorder's reception times a ramp would be a staircase.
    select = partial(recording.select, report=skipped.append)
    sent = SenderOrder(recording, selection, SenderClock(recording), select=select, ends=True)
    with CopyWriter(target, profile=profile) as writer:
        writer.copy_attachments_and_metadata([recording])
        for sent_ns, _, message in sent:
            try:
                made = list(encode(message))
            except (TypeError, ValueError, KeyError) as error:
                refused.append(f"{message.channel_topic}, seq {message.seq}: {error}")
                continue
            for key, data in made:
                if (channel := channels.get(key)) is None:
                    channel = channels[key] = RawChannel(*describe(key))
                writer.add(RawMessage(channel, sent_ns, message.publish_ns, message.seq, data))
    return CopyResult(path=str(target), messages=writer.messages, skipped=(*describe_damage(skipped), *refused))


def _plain_schema_of(topic: str) -> dict[str, Any]:
    model = model_of(topic)
    return {"type": "object", "properties": {}} if model is None else plain_schema(json_schema(model))


def viewer_json(topic: str) -> Payload:
    """Return the JSON form of a topic for viewers: encoding, schema (name, encoding and data) and encoder.

    Each time in ns is repeated as a string of digits: a viewer in JavaScript keeps numbers as doubles, which round
    today's time to 256 ns.
    """
    return _as_json(topic, _plain_schema_of(topic))


def _as_json(topic: str, plain: Mapping[str, Any]) -> Payload:
    properties = plain["properties"]
    times = [name for name, part in properties.items() if name.endswith("_ns") and part.get("type") == "integer"]
    texts = {f"{name}{_TEXT}": {"type": "string", "description": f"{name} in digits"} for name in times}
    schema = {**plain, "properties": {**properties, **texts}}
    name = f"telenano.{plain['title']}" if "title" in plain else topic

    def encode(fields: dict[str, Any]) -> bytes:
        document = fitted(fields, schema)
        digits = {f"{time}{_TEXT}": str(document[time]) for time in document if f"{time}{_TEXT}" in texts}
        return json.dumps({**document, **digits}, separators=(",", ":")).encode()

    return "json", (name, "jsonschema", json.dumps(schema).encode()), encode


def fitted(value: Any, schema: Mapping[str, Any]) -> Any:
    """Return a value that fits its plain schema: nil fields are dropped, and an array of any shape is one flat list."""
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

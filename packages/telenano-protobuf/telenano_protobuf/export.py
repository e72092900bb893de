"""A recording as MCAP with protobuf, which Rerun, Foxglove and Lichtblick decode."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from telenano.recording import CopyResult, Recording, Selection, write_viewer_mcap
from telenano_protobuf.message import ProtobufMessage


def export_protobuf(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    """Write the chosen channels of a recording as protobuf, each with the descriptor of its message.

    A topic that this version does not know is text of JSON.

    Raises:
        RecordingError: The target cannot be written.
    """
    return write_viewer_mcap(recording, target, selection, _payload_of)


def _payload_of(
    topic: str, schema: Mapping[str, Any]
) -> tuple[str, tuple[str, str, bytes], Callable[[dict[str, Any]], bytes]]:
    if "title" not in schema:
        unknown = ProtobufMessage("Unknown", {"properties": {"json": {"type": "object"}}})
        described = (unknown.name, "protobuf", unknown.descriptor_set)
        return "protobuf", described, lambda fields: unknown.encode({"json": fields})
    message = ProtobufMessage(schema["title"], schema)
    return "protobuf", (message.name, "protobuf", message.descriptor_set), message.encode

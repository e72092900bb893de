"""A recording as MCAP with protobuf, which Rerun, Foxglove and Lichtblick decode."""

from pathlib import Path

from telenano.recording import CopyResult, Payload, Recording, Selection, model_of, plain_schema, write_viewer_mcap
from telenano.wire import json_schema
from telenano_protobuf.message import ProtobufMessage


def export_protobuf(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    """Write the chosen channels of a recording as protobuf, each with the descriptor of its message.

    A topic that this version does not know is text of JSON.

    Raises:
        RecordingError: The target cannot be written.
    """
    return write_viewer_mcap(recording, target, selection, _payload_of)


def _payload_of(topic: str) -> Payload:
    model = model_of(topic)
    if model is None:
        unknown = ProtobufMessage("Unknown", {"properties": {"json": {"type": "object"}}})
        described = (unknown.name, "protobuf", unknown.descriptor_set)
        return Payload("protobuf", described, lambda fields: unknown.encode({"json": fields}))
    message = ProtobufMessage(model.__name__, plain_schema(json_schema(model)))
    return Payload("protobuf", (message.name, "protobuf", message.descriptor_set), message.encode)

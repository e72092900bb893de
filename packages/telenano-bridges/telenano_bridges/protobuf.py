"""Encodes messages as protobuf, for viewers that cannot decode msgpack; the declared contract gives the descriptors.

A protobuf message contains no schema, so each channel of the file has the descriptor of its message, with the
descriptions of the contract (and so the units) as comments of the fields. Field numbers count the fields in the order
of the contract; they are valid within one file only.
"""

import base64
import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from telenano.recording import CopyResult, Recording, Selection, write_viewer_mcap

_PACKAGE = "telenano"
# Beginning of the description of an array of whole numbers, such as "i8: time of the turn".
_WHOLE_ELEMENTS = re.compile(r"(u1|i2|i4|i8): ")


class ProtobufMessage:
    """The protobuf message of one model of the contract, made from its plain JSON Schema.

    Numbers are double or int64, and optional, so that an absent number differs from 0; vectors and arrays are repeated
    numbers, parts of a message are messages; maps, whose keys the contract does not fix, are JSON texts.
    """

    def __init__(self, name: str, schema: Mapping[str, Any]) -> None:
        """Build the descriptor."""
        # The type is Any because the class is made at run time.
        self._file: Any = descriptor_pb2.FileDescriptorProto(
            name=f"{_PACKAGE}/{name}.proto", package=_PACKAGE, syntax="proto3"
        )
        self._fit = self._add_message(name, schema)
        pool = descriptor_pool.DescriptorPool()
        pool.Add(self._file)
        self.name = f"{_PACKAGE}.{name}"
        self.descriptor_set: bytes = descriptor_pb2.FileDescriptorSet(file=[self._file]).SerializeToString()
        self._kind: Any = message_factory.GetMessageClass(pool.FindMessageTypeByName(self.name))

    def encode(self, fields: Mapping[str, Any]) -> bytes:
        """Return a message, given as JSON values, in protobuf; keys unknown to the contract are left out.

        Raises:
            TypeError: A value is not of the type of its field.
            ValueError: A value is impossible in its field.
        """
        data: bytes = self._kind(**self._fit(fields)).SerializeToString(deterministic=True)
        return data

    def _add_message(self, name: str, schema: Mapping[str, Any]) -> Callable[[Any], Any]:
        """Declare a message; return the function that converts its JSON value to the values of its fields."""
        number, message = len(self._file.message_type), self._file.message_type.add(name=name)
        fits: dict[str, Callable[[Any], Any]] = {}
        for place, (key, part) in enumerate(schema["properties"].items()):
            field = message.field.add(name=key, number=place + 1)
            fits[key] = self._set_type(field, f"{name}_{key}", part)
            if field.label != field.LABEL_REPEATED:
                field.label = field.LABEL_OPTIONAL
                if field.type != field.TYPE_MESSAGE:
                    # Protobuf expresses an optional number as a oneof with one member.
                    field.proto3_optional, field.oneof_index = True, len(message.oneof_decl)
                    message.oneof_decl.add(name=f"_{key}")
            if part.get("description"):
                path = (4, number, 2, place)
                self._file.source_code_info.location.add(
                    path=path, span=(place, 0, 0), leading_comments=part["description"]
                )

        def fit(value: Mapping[str, Any]) -> dict[str, Any]:
            return {key: fits[key](part) for key, part in value.items() if key in fits and part is not None}

        return fit

    def _set_type(self, field: Any, name: str, part: Mapping[str, Any]) -> Callable[[Any], Any]:
        kind = part.get("type")
        if kind == "array":
            field.label = field.LABEL_REPEATED
            items = part["items"]
            if items.get("type") in ("number", "integer"):
                whole = items["type"] == "integer" or _WHOLE_ELEMENTS.match(part.get("description", ""))
                field.type = field.TYPE_INT64 if whole else field.TYPE_DOUBLE
                return _elements
            fit = self._set_type(field, name, items)
            field.label = field.LABEL_REPEATED
            return lambda values: [fit(value) for value in values]
        if kind == "object" and part.get("properties"):
            field.type, field.type_name = field.TYPE_MESSAGE, f".{_PACKAGE}.{name}"
            return self._add_message(name, part)
        if kind == "string" and part.get("contentEncoding") == "base64":
            field.type = field.TYPE_BYTES
            return base64.b64decode
        field.type = {
            "number": field.TYPE_DOUBLE,
            "integer": field.TYPE_INT64,
            "boolean": field.TYPE_BOOL,
        }.get(str(kind), field.TYPE_STRING)
        return json.dumps if kind in ("object", None) else _unchanged


def _unchanged(value: Any) -> Any:
    return value


def _elements(value: Any) -> list[Any]:
    """Return the numbers of an array of any shape in C order."""
    if not isinstance(value, list):
        return [value]
    return [number for part in value for number in _elements(part)]


def export_protobuf(recording: Recording, target: Path, selection: Selection) -> CopyResult:
    """Write the selected channels of a recording as protobuf, each with the descriptor of its message.

    Messages of a topic unknown to this version become JSON texts.

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

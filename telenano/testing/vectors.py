"""The bytes and the schemas that a package's messages are held to, beside its tests: golden bytes, and `schemas/`."""

import json
from pathlib import Path
from typing import Any

from telenano.wire import Topic, decode, encode
from telenano.wire.codec import decode_header
from telenano.wire.schema import json_schema
from telenano.wire.topics import register_topic


def vectors_of(path: Path, *rows: Topic) -> list[dict[str, Any]]:
    """Return the golden vectors of a file, after the topics of a package are taken up."""
    for row in rows:
        register_topic(row)
    vectors: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    return vectors


def case_of(vector: dict[str, Any]) -> str:
    """Return the name of a test of a vector."""
    return f"{vector['topic']}-{vector['case']}"


def assert_same_bytes(vector: dict[str, Any]) -> None:
    """Read the bytes of a vector and write them again."""
    payload = bytes.fromhex(vector["hex"])
    message = decode(vector["topic"], payload)
    assert type(message).__name__ == vector["message"]
    assert encode(message) == payload
    _, fields = decode_header(vector["topic"], payload)
    assert json.loads(json.dumps(fields, default=bytes.hex)) == vector["fields"]


def assert_same_schema(folder: Path, row: Topic) -> None:
    """Compare the schema of a message with the one that clients in other languages have."""
    committed = json.loads((folder / f"{row.model.__name__}.json").read_text(encoding="utf-8"))
    schema = json_schema(row.model)
    assert (committed["x-topic"], committed["x-version"]) == (row.name, row.model.version)
    assert list(schema["properties"]) == list(committed["properties"])
    for name, part in schema["properties"].items():
        if name != "v":
            assert part == committed["properties"][name], name

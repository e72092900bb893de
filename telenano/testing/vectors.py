"""Checks of a package's messages against golden bytes and committed schemas (`schemas/`), stored beside its tests."""

import json
from pathlib import Path
from typing import Any

from telenano.wire import Topic, decode, encode
from telenano.wire.codec import decode_header
from telenano.wire.schema import json_schema
from telenano.wire.topics import register_topic


def vectors_of(path: Path, *rows: Topic) -> list[dict[str, Any]]:
    """Register the topics of a package, and return the golden vectors of a file."""
    for row in rows:
        register_topic(row)
    vectors: list[dict[str, Any]] = json.loads(path.read_text(encoding="utf-8"))
    return vectors


def case_of(vector: dict[str, Any]) -> str:
    """Return the name of the test case of a vector."""
    return f"{vector['topic']}-{vector['case']}"


def assert_same_bytes(vector: dict[str, Any]) -> None:
    """Check that the bytes of a vector decode to its message and fields, and encode to the same bytes."""
    payload = bytes.fromhex(vector["hex"])
    message = decode(vector["topic"], payload)
    assert type(message).__name__ == vector["message"]
    assert encode(message) == payload
    _, fields = decode_header(vector["topic"], payload)
    assert json.loads(json.dumps(fields, default=bytes.hex)) == vector["fields"]


def assert_same_schema(folder: Path, row: Topic) -> None:
    """Check that the schema of a message equals the committed one, which clients in other languages use."""
    committed = json.loads((folder / f"{row.model.__name__}.json").read_text(encoding="utf-8"))
    schema = json_schema(row.model)
    assert (committed["x-topic"], committed["x-version"]) == (row.name, row.model.version)
    assert list(schema["properties"]) == list(committed["properties"])
    for name, part in schema["properties"].items():
        if name != "v":
            assert part == committed["properties"][name], name

"""The truth about particles keeps the bytes and the schema that it had in the core."""

import json
from pathlib import Path
from typing import Any

import pytest
from telenano_assembly.messages import AFM_PARTICLES

from telenano.wire import Topic, decode, decode_header, encode, json_schema, take_up

HERE = Path(__file__).parent
for _row in (AFM_PARTICLES,):
    take_up(_row)
VECTORS = json.loads((HERE / "golden_particles.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: f"{vector['topic']}-{vector['case']}")
def test_golden_bytes_are_read_and_written_as_ever(vector: dict[str, Any]) -> None:
    payload = bytes.fromhex(vector["hex"])
    message = decode(vector["topic"], payload)
    assert type(message).__name__ == vector["message"]
    assert encode(message) == payload
    _, fields = decode_header(vector["topic"], payload)
    assert json.loads(json.dumps(fields, default=bytes.hex)) == vector["fields"]


def test_every_topic_has_its_vectors() -> None:
    assert {vector["topic"] for vector in VECTORS} == {row.name for row in (AFM_PARTICLES,)}
    assert len(VECTORS) == 9


@pytest.mark.parametrize("row", [AFM_PARTICLES], ids=lambda row: row.name)
def test_the_schema_is_the_one_that_clients_in_other_languages_have(row: Topic) -> None:
    committed = json.loads((HERE / "schemas" / f"{row.model.__name__}.json").read_text(encoding="utf-8"))
    schema = json_schema(row.model)
    assert (committed["x-topic"], committed["x-version"]) == (row.name, row.model.version)
    assert list(schema["properties"]) == list(committed["properties"])
    for name, part in schema["properties"].items():
        if name != "v":
            assert part == committed["properties"][name], name

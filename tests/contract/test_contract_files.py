"""The committed schemas, golden bytes and topic table are those of the models, and say so when they are not."""

import json
import math
import typing
from typing import Any

import msgpack
import msgspec
import pytest
import spec_client
from wire_contract import FOLDER, artefacts, present_fields

from telenano.testing.filled_messages import CASES, WITH_OPTIONAL, has_optional_keys
from telenano.wire import decode, encode
from telenano.wire.codec import WireError, accept
from telenano.wire.messages import Record
from telenano.wire.topics import OWN_TOPICS as TOPICS

VECTORS: list[dict[str, Any]] = json.loads((FOLDER / "golden" / "vectors.json").read_text(encoding="utf-8"))

VECTORS_OF = {topic: [vector for vector in VECTORS if vector["topic"] == topic] for topic in TOPICS}


def _python_form(value: Any) -> Any:
    """Undo what JSON cannot hold: arrays are tuples, data is bytes."""
    if isinstance(value, dict):
        data = {"data": bytes.fromhex(value["data"])} if set(value) == {"dtype", "shape", "data"} else {}
        return {key: _python_form(part) for key, part in value.items()} | data
    return tuple(map(_python_form, value)) if isinstance(value, list) else value


def _same(a: Any, b: Any) -> bool:
    """Compare to the bit and the type: 1, 1.0 and True differ, and so do 0.0 and -0.0."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same(a[key], b[key]) for key in a)
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(map(_same, a, b))
    signs_agree = not isinstance(a, float) or math.copysign(1.0, a) == math.copysign(1.0, b)
    return type(a) is type(b) and a == b and signs_agree


def test_making_the_files_twice_gives_the_same() -> None:
    assert artefacts() == artefacts()


def test_every_message_has_every_case() -> None:
    cases = {topic: [case.name for case in CASES] for topic in TOPICS}
    for topic, row in TOPICS.items():
        if has_optional_keys(row):
            cases[topic] += [case.name + WITH_OPTIONAL for case in CASES]
    assert [(v["topic"], v["case"]) for v in VECTORS] == [(topic, case) for topic in TOPICS for case in cases[topic]]


def test_every_message_has_the_version_of_its_topic() -> None:
    assert all(vector["fields"]["v"] == TOPICS[vector["topic"]].model.version for vector in VECTORS)


@pytest.mark.parametrize("topic", TOPICS)
def test_golden_fields_encode_to_golden_bytes(topic: str) -> None:
    for vector in VECTORS_OF[topic]:
        message = decode(topic, msgpack.packb(_python_form(vector["fields"])))
        assert type(message) is TOPICS[topic].model
        assert type(message).__name__ == vector["message"]
        assert encode(message).hex() == vector["hex"], vector["case"]


@pytest.mark.parametrize("topic", TOPICS)
def test_golden_bytes_decode_to_golden_fields(topic: str) -> None:
    for vector in VECTORS_OF[topic]:
        message = decode(topic, bytes.fromhex(vector["hex"]))
        assert _same(present_fields(message), _python_form(vector["fields"])), vector["case"]


@pytest.mark.parametrize("topic", TOPICS)
def test_who_acts_on_a_golden_message_refuses_what_is_beyond_a_range_alone(topic: str) -> None:
    for vector in VECTORS_OF[topic]:
        payload = bytes.fromhex(vector["hex"])
        kinds = [field.type for field in msgspec.structs.fields(TOPICS[topic].model) if field.name in vector["fields"]]
        if vector["case"].startswith("greatest") and any(map(_has_a_range, kinds)):
            with pytest.raises(WireError) as caught:
                accept(topic, payload)
            assert caught.value.reason == "range", vector["case"]
        else:
            assert accept(topic, payload) == decode(topic, payload), vector["case"]


def _has_a_range(kind: Any) -> bool:
    """Say whether a quantity stands in a field, or in a record in it."""
    if any("range" in (rule.extra or {}) for rule in getattr(kind, "__metadata__", ())):
        return True
    if isinstance(kind, type) and issubclass(kind, Record):
        return any(_has_a_range(field.type) for field in msgspec.structs.fields(kind))
    parts = (getattr(kind, "__origin__", None), *typing.get_args(kind))
    return any(_has_a_range(part) for part in parts if part is not None and part is not kind)


def test_the_comparison_can_fail() -> None:
    assert not _same({"a": (0.0,)}, {"a": (-0.0,)})
    assert not _same(1, 1.0)
    assert not _same(True, 1)
    assert not _same((1.0, 2.0), (1.0,))


def test_golden_vectors_reach_the_corners() -> None:
    text = json.dumps([vector["fields"] for vector in VECTORS])
    corners = ("-0.0", "1.7976931348623157e+308", "5e-324", str(2**63 - 1), str(-(2**63)), str(2**53 + 1), "null")
    for corner in (*corners, '"shape": [0]', '"f4"', "\\u00c5"):
        assert corner in text, corner


@pytest.mark.parametrize("topic", TOPICS)
def test_schemas_describe_the_bytes(topic: str) -> None:
    schema = spec_client.schemas()[topic]
    for vector in VECTORS_OF[topic]:
        payload, case = bytes.fromhex(vector["hex"]), vector["case"]
        fields = spec_client.msgpack.unpackb(payload)
        # the schemas say what is acted on, ranges included
        within = spec_client.conforms(fields, schema, schema)
        try:
            accept(topic, payload)
        except WireError as error:
            assert (error.reason, within) == ("range", False), case
        else:
            assert within, case
        for key in fields:
            without = {k: v for k, v in fields.items() if k != key}
            if within or key in schema["required"]:
                expected = key not in schema["required"]
                assert spec_client.conforms(without, schema, schema) == expected, (case, key)
            assert not spec_client.conforms({**fields, key: b"raw"}, schema, schema), (case, key)
        further = {**fields, "unknown_n": 1.0}
        assert spec_client.conforms(further, schema, schema) == (within and topic != "session/control"), case
        assert not spec_client.conforms({**fields, "v": schema["x-version"] + 1}, schema, schema), case

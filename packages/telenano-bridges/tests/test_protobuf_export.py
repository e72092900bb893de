"""A recording as protobuf, read back by what the file says of itself."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader
from telenano_bridges.protobuf import _payload_of

from telenano.recording import export_recording, recorded
from telenano.testing import write_recording
from telenano.wire import OWN_TOPICS as TOPICS
from telenano.wire import example

EPOCH_NS = 1_750_000_000_000_000_000


class Decoded:
    """Decoder of an MCAP file of protobuf that knows nothing but what the file says of itself."""

    def __init__(self, path: Path) -> None:
        self.messages: dict[str, list[Any]] = {}
        self.comments: dict[str, list[str]] = {}
        kinds: dict[int, Any] = {}
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
                assert schema is not None
                assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
                if schema.id not in kinds:
                    kinds[schema.id], rows = kind_of(schema.name, schema.data)
                    self.comments[schema.name] = [row.leading_comments for row in rows]
                self.messages.setdefault(channel.topic, []).append(kinds[schema.id].FromString(message.data))


def kind_of(name: str, data: bytes) -> tuple[Any, Any]:
    files = FileDescriptorSet.FromString(data).file
    pool = DescriptorPool()
    for described in files:
        pool.Add(described)
    return GetMessageClass(pool.FindMessageTypeByName(name)), files[0].source_code_info.location


def same(fields: dict[str, Any], found: Any) -> bool:
    """Say whether a message of protobuf has these JSON values: no less, and nothing that is absent."""
    for key, value in fields.items():
        field = found.DESCRIPTOR.fields_by_name[key]
        other = getattr(found, key)
        if value is None:
            # a list has no absence, it is empty
            equal = len(other) == 0 if field.is_repeated else not found.HasField(key)
        elif field.type == field.TYPE_MESSAGE:
            parts = zip(value, other, strict=True) if field.is_repeated else [(value, other)]
            equal = all(same(*part) for part in parts)
        elif isinstance(value, dict):
            equal = json.loads(other) == value
        elif isinstance(value, list):
            equal = np.array_equal(np.ravel(value), np.array(list(other)))
        else:
            equal = other == value and type(other) is type(value)
        if not equal:
            return False
    return True


@pytest.fixture
def read(tmp_path: Path) -> Decoded:
    sent = [
        recorded(topic, example(topic, src="afm_node@slave", seq=seq), EPOCH_NS + seq)
        for topic in TOPICS
        for seq in range(2)
    ]
    recording = write_recording(tmp_path / "recorded", sent)
    assert not export_recording(recording, tmp_path / "viewer.mcap", "protobuf").skipped
    return Decoded(tmp_path / "viewer.mcap")


@pytest.mark.parametrize("topic", sorted(TOPICS))
def test_every_message_survives_with_what_is_absent_told_from_nought(read: Decoded, topic: str) -> None:
    for seq, found in enumerate(read.messages[topic]):
        message = recorded(topic, example(topic, src="afm_node@slave", seq=seq), EPOCH_NS + seq)
        assert same(message.plain(), found)


def test_units_are_comments_of_the_fields(read: Decoded) -> None:
    assert "Force on the device by the operator [N]; pushing is -z, F_m = -z" in read.comments["telenano.HapticState"]


def test_nanoseconds_keep_all_digits(tmp_path: Path) -> None:
    t_ns = EPOCH_NS + 123_456_789
    recording = write_recording(tmp_path / "r", [recorded("afm/state", example("afm/state", t_ns=t_ns), EPOCH_NS)])
    export_recording(recording, tmp_path / "viewer.mcap", "protobuf")
    (found,) = Decoded(tmp_path / "viewer.mcap").messages["afm/state"]
    assert found.t_ns == t_ns


def test_a_topic_that_this_version_does_not_know_is_text_of_json() -> None:
    _, (name, encoding, data), encode = _payload_of("new/topic", {"type": "object", "properties": {}})
    assert encoding == "protobuf"
    found = kind_of(name, data)[0].FromString(encode({"a": 1}))
    assert json.loads(found.json) == {"a": 1}

"""A recording as a bag of ROS 2, read back by two libraries that know ROS 2 and nothing of this project."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags import typesys
from rosbags.highlevel import AnyReader
from telenano_bridges.ros2 import Encoder, definitions

from telenano.recording import RecordedMessage, export_recording, recorded
from telenano.testing import EPOCH_NS, hand_state, numbered, write_recording

SECOND_NS = 10**9


def session() -> Iterator[RecordedMessage]:
    vectors = {"base_position_m": (0.0, 0.0, -3e-9), "tip_force_n": (0.0, 0.0, 7e-9)}
    for seq in range(4):
        log_ns = EPOCH_NS + seq
        yield recorded("haptic/state", hand_state(seq), log_ns)
        yield recorded(
            "afm/state", numbered("afm/state", seq, src="afm_node@slave", deflection_m=1e-9, **vectors), log_ns
        )
        for mode in ("position", "hold"):
            fields = {"mode": mode, "base_position_m": (0.0, 0.0, -4e-9)}
            yield recorded("afm/command", numbered("afm/command", seq, src="controller@slave", **fields), log_ns)
        event = numbered("session/event", seq, src="afm_node@slave", text=f"µ {seq}")
        yield recorded("session/event", event, log_ns)
        # the copy that crossed the link is not said twice
        yield recorded("session/event", event, log_ns, "master")


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    target = tmp_path / "ros2.mcap"
    export_recording(write_recording(tmp_path / "recorded", session()), target, "ros2")
    return target


def test_rosbags_reads_every_message_with_its_time_and_value(bag: Path) -> None:
    found: dict[str, list[Any]] = {}
    with AnyReader([bag]) as reader:
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((connection.msgtype, time_ns, message))
    states = [hand_state(seq) for seq in range(4)]
    hand = found["/hand/measured_cp"]
    assert [kind for kind, _, _ in hand] == ["geometry_msgs/msg/PoseStamped"] * 4
    where = [(m.pose.position.x, m.pose.position.y, m.pose.position.z) for _, _, m in hand]
    assert where == [state.position_m for state in states]
    stamps = [m.header.stamp.sec * SECOND_NS + m.header.stamp.nanosec for _, _, m in hand]
    assert stamps == [state.t_ns for state in states]
    assert {(m.header.frame_id, m.pose.orientation.w) for _, _, m in hand} == {("master", 1.0)}
    forces = [m.wrench.force.z for _, _, m in found["/hand/measured_cf"]]
    assert forces == [state.operator_force_n[2] for state in states]
    assert [m.wrench.force.z for _, _, m in found["/tip/measured_cf"]] == [7e-9] * 4
    # The deflection is away from the sample, as z is.
    assert [m.pose.position.z for _, _, m in found["/tip/measured_cp"]] == [-3e-9 + 1e-9] * 4
    assert [m.pose.position.z for _, _, m in found["/tip/servo_cp"]] == [-4e-9] * 4
    assert [json.loads(m.data)["text"] for _, _, m in found["/session/event"]] == [f"µ {seq}" for seq in range(4)]


def test_a_second_reader_decodes_it_by_the_schemas_in_the_file_alone(bag: Path) -> None:
    with bag.open("rb") as stream:
        decoded = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        found = [(channel.topic, message) for _, channel, _, message in decoded]
    tips = [message.wrench.force.z for topic, message in found if topic == "/tip/measured_cf"]
    assert tips == [7e-9] * 4
    with bag.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == len(found)
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}


def test_the_definitions_are_those_of_ros() -> None:
    encoder, ros = Encoder(), typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    for kind in definitions():
        assert encoder.type_hash(kind) == ros.hash_rihs01(kind), kind

from typing import Any

import msgpack
import pytest

from services.viz_node.requests import (
    CommandRequest,
    DocumentRequest,
    EstopRequest,
    HandRequest,
    Hello,
    PartRequest,
    RecordingRequest,
    RequestError,
    TransportRequest,
    read_request,
)
from telenano.serving.serve import LARGEST_FRAME

COMMAND: dict[str, Any] = {
    "k": "command",
    "id": "a-1",
    "command": "set",
    "target": "controller",
    "parameters": {"law": "wave", "x": 1.5, "on": True},
}


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"k": "hello", "token": "t", "protocol": 1}, Hello("t", 1)),
        (COMMAND, CommandRequest("a-1", "set", "controller", {"law": "wave", "x": 1.5, "on": True})),
        ({"k": "estop", "id": "a-2"}, EstopRequest("a-2")),
        ({"k": "transport", "id": "a-3", "action": "seek", "value": 2}, TransportRequest("a-3", "seek", 2.0)),
        ({"k": "document", "id": "a-4"}, DocumentRequest("a-4")),
        (
            {"k": "part", "id": "a-5", "from_s": 1, "to_s": 2.5, "spans": 600},
            PartRequest("a-5", 1.0, 2.5, 600),
        ),
        ({"k": "recording", "id": "a-6", "name": "session.mcap"}, RecordingRequest("a-6", "session.mcap")),
        ({"k": "hand", "force_n": -1, "held": True}, HandRequest(-1.0, True)),
        (
            {"k": "hand", "force_n": 0, "across_x_n": 1, "across_y_n": -2.0, "held": True},
            HandRequest(0.0, True, 1.0, -2.0),
        ),
    ],
)
def test_a_frame_of_a_page_is_read(fields: dict[str, Any], expected: object) -> None:
    assert read_request(msgpack.packb(fields)) == expected


@pytest.mark.parametrize(
    ("frame", "fault"),
    [
        (b"", "msgpack map"),
        (b"\xc1", "msgpack map"),
        (b"\x93\x01\x02\x03", "`object`"),
        (b"\x81" * 4000, "object"),
        (b"\xdf\xff\xff\xff\xff", "msgpack map"),
        (bytes(LARGEST_FRAME + 1), "65537 bytes"),
        (msgpack.packb({}), "`k`"),
        (msgpack.packb({"k": "hello", "token": 1, "protocol": 1}), "token"),
        (msgpack.packb({"k": "hello", "token": "t", "protocol": True}), "protocol"),
        (msgpack.packb({**COMMAND, "command": "estop"}), "'estop'"),
        (msgpack.packb({**COMMAND, "id": "../x"}), "id"),
        (msgpack.packb({**COMMAND, "target": "x" * 257}), "target"),
        (msgpack.packb({**COMMAND, "parameters": {"x": float("nan")}}), r"parameters\.x"),
        (msgpack.packb({**COMMAND, "parameters": {"x": None}}), "parameters"),
        (msgpack.packb({**COMMAND, "parameters": {"x": 2**63}}), "parameters"),
        (msgpack.packb({**COMMAND, "parameters": {str(i): 1 for i in range(65)}}), "parameters"),
        (msgpack.packb({"k": "part", "id": "a", "from_s": float("nan"), "to_s": 1, "spans": 1}), "from_s"),
        (msgpack.packb({"k": "part", "id": "a", "from_s": 0, "to_s": 1, "spans": 1.5}), "spans"),
        (msgpack.packb({"k": "hand", "force_n": float("inf"), "held": True}), "force_n"),
        (msgpack.packb({"k": "hand", "force_n": True, "held": True}), "force_n"),
        (msgpack.packb({"k": "hand", "force_n": 1.0, "held": 1}), "held"),
    ],
)
def test_any_other_frame_is_refused_in_words(frame: bytes, fault: str) -> None:
    with pytest.raises(RequestError, match=fault):
        read_request(frame)

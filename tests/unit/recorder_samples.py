"""Messages to record; a module of its own, because other folders have a conftest too."""

import json
from pathlib import Path
from typing import Any

import proto
from proto import Message, decode

EPOCH_NS = 1_750_000_000_000_000_000
MILLISECOND_NS = 1_000_000
NODE = "recorder@master"


_GOLDEN = {
    vector["topic"]: bytes.fromhex(vector["hex"])
    for vector in json.loads((Path(proto.__file__).parent / "golden" / "vectors.json").read_text())
    if vector["case"] == "minimal"
}


def sample(topic: str, seq: int, **changes: Any) -> Message:
    """Return a valid message; fields that no test asks for come from the golden vectors of the wire."""
    base = decode(topic, _GOLDEN[topic])
    header = {"seq": seq, "t_ns": EPOCH_NS + seq * MILLISECOND_NS}
    return type(base)(**(base.__dict__ | header | changes))


def haptic_state(seq: int, **changes: Any) -> Message:
    fields = {
        # a test that publishes for long stays within the ranges of the wire
        "position_m": (0.0, 0.0, -1e-3 * (seq % 10_000)),
        "operator_force_n": (0.1, 0.2, -0.5 - seq % 10_000),
        "limited": seq % 2 == 1,
    }
    return sample("haptic/state", seq, src="haptic_node@master", **(fields | changes))


def teleop_forward(seq: int, **changes: Any) -> Message:
    fields = {"wave_sqrt_w": None, "force_n": (0.0, 0.0, 1e-9)}
    return sample("teleop/forward", seq, src="controller@master", **(fields | changes))


def session_control(seq: int, **changes: Any) -> Message:
    fields = {"id": f"id{seq}", "command": "mark", "target": "*", "parameters": {}}
    return sample("session/control", seq, src="launcher@master", **(fields | changes))

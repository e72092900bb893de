"""Messages to record; a module of its own, because other folders have a conftest too."""

from typing import Any

import msgspec

from telenano.wire import TOPICS, Message, example
from telenano.wire.codec import fields_of as fields_of_message

EPOCH_NS = 1_750_000_000_000_000_000
MILLISECOND_NS = 1_000_000
NODE = "recorder@master"


def sample(topic: str, seq: int, **changes: Any) -> Message:
    """Return a valid message; fields that no test asks for come from the golden vectors of the wire."""
    return example(topic, **({"seq": seq, "t_ns": EPOCH_NS + seq * MILLISECOND_NS} | changes))


def fields_of(topic: str, **changes: Any) -> dict[str, Any]:
    """Return the fields of a valid message without its header; those that no test asks for as in `sample`."""
    required = {field.name for field in msgspec.structs.fields(TOPICS[topic].model) if field.required}
    found = fields_of_message(example(topic))
    present = {name: value for name, value in found.items() if value is not None or name in required}
    return {name: value for name, value in (present | changes).items() if name not in ("seq", "t_ns", "src", "v")}


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

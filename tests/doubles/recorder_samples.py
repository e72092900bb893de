"""Messages to record; a separate module instead of a conftest, because other folders have a conftest too."""

from typing import Any

from telenano.testing import EPOCH_NS, fields_of
from telenano.testing import hand_state as haptic_state
from telenano.testing import numbered as sample
from telenano.wire import Message

__all__ = [
    "EPOCH_NS", "MILLISECOND_NS", "NODE", "fields_of", "haptic_state", "sample", "session_control", "teleop_forward",
]  # fmt: skip
MILLISECOND_NS = 1_000_000
NODE = "recorder@master"


def teleop_forward(seq: int, **changes: Any) -> Message:
    fields = {"wave_sqrt_w": None, "force_n": (0.0, 0.0, 1e-9)}
    return sample("teleop/forward", seq, src="controller@master", **(fields | changes))


def session_control(seq: int, **changes: Any) -> Message:
    fields = {"id": f"id{seq}", "command": "mark", "target": "*", "parameters": {}}
    return sample("session/control", seq, src="launcher@master", **(fields | changes))

"""When a rig is ready: every node says so and hears what it needs."""

from collections.abc import Iterable, Mapping

from proto import TOPICS
from proto.messages import NodeHealth

_LOOP_RATE_HZ = 100.0


def silent_inputs(health: NodeHealth) -> list[str]:
    """Give the topics sent at a declared rate of which a node, at whichever of its sockets, has heard nothing."""
    heard = {row.topic for row in health.inputs if row.age_valid}
    return sorted({row.topic for row in health.inputs if row.topic not in heard and _rate_hz(row.topic) > 0.0})


def unmet(nodes: Iterable[str], health: Mapping[str, NodeHealth]) -> dict[str, str]:
    """Give for each node that is not ready what it waits for, in words; empty when the rig is ready."""
    waiting: dict[str, str] = {}
    for node in nodes:
        newest = health.get(node)
        if newest is None:
            waiting[node] = "has not been heard"
        elif newest.state == "starting":
            waiting[node] = "is still starting"
        elif silent := silent_inputs(newest):
            waiting[node] = f"does not hear {', '.join(silent)}"
    return waiting


def oldest_input_s(health: NodeHealth) -> float | None:
    """Give the age of the oldest input of the loop [s]; None when nothing was heard.

    Reports, at 2 Hz, are left out: their age would hide that of everything else.
    """
    ages = [row.age_s for row in health.inputs if row.age_valid and _rate_hz(row.topic) >= _LOOP_RATE_HZ]
    return max(ages, default=None)


def _rate_hz(topic: str) -> float:
    """Give the declared rate [Hz]; 0 for topics sent on change, and for those that this version does not know."""
    row = TOPICS.get(topic)
    return row.rate_hz or 0.0 if row else 0.0

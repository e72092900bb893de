"""When a rig is ready: every node reports it and receives its inputs."""

from collections.abc import Iterable, Mapping, Sequence

from telenano.settings.package_topics import row_of
from telenano.timing.clock import Clock
from telenano.wire.messages import NodeHealth

READY_DEADLINE_S = 60.0
_LOOP_RATE_HZ = 100.0


def silent_inputs(health: NodeHealth) -> list[str]:
    """Return the topics sent at a declared rate of which a node has received nothing at any of its sockets, sorted."""
    received = {row.topic for row in health.inputs if row.age_valid}
    return sorted({row.topic for row in health.inputs if row.topic not in received and _rate_hz(row.topic) > 0.0})


def unmet(nodes: Iterable[str], health: Mapping[str, NodeHealth], *, inputs: bool = True) -> dict[str, str]:
    """Return for each node that is not ready what it waits for, in words; empty when the rig is ready.

    Without `inputs` a node is ready that receives nothing yet.
    """
    waiting: dict[str, str] = {}
    for node in nodes:
        newest = health.get(node)
        if newest is None:
            waiting[node] = "has not reported yet"
        elif newest.state == "starting":
            waiting[node] = "is still starting"
        elif inputs and (silent := silent_inputs(newest)):
            waiting[node] = f"does not receive {', '.join(silent)}"
    return waiting


class ReadinessGate:
    """Which nodes have to become ready, and by when.

    Each own node has a limit. Nodes that run elsewhere are waited for without one, unless a limit is given; as long as
    one of them is missing, own nodes may lack inputs that only it could send.
    """

    def __init__(
        self, clock: Clock, own: Sequence[str], others: Sequence[str] = (), wait_s: float | None = None
    ) -> None:
        """Begin to wait for own nodes and for others, for these up to `wait_s` [s], None for no limit."""
        self._clock = clock
        self._own = tuple(own)
        self._others = tuple(others)
        self._wait_s = wait_s
        self.reset()

    def reset(self) -> None:
        self._begun_ns = self._clock.monotonic_ns()
        # Each own node has not been ready since this time, through no fault of another one.
        self._not_ready_since_ns = dict.fromkeys(self._own, self._begun_ns)

    def waiting(self, health: Mapping[str, NodeHealth]) -> dict[str, str]:
        """Return for each node that is not ready what it waits for."""
        return unmet((*self._own, *self._others), health)

    def causes(self, health: Mapping[str, NodeHealth]) -> dict[str, str]:
        """Return what `waiting` does, without inputs that a node lacks only because another one is missing."""
        return {**unmet(self._own, health, inputs=self._others_present(health)), **unmet(self._others, health)}

    def _others_present(self, health: Mapping[str, NodeHealth]) -> bool:
        return all(node in health for node in self._others)

    def overdue(self, health: Mapping[str, NodeHealth]) -> tuple[float, dict[str, str]]:
        """Return the limit that was exceeded [s] and what the late nodes wait for; none while there is time."""
        now = self._clock.monotonic_ns()
        not_ready = unmet(self._own, health, inputs=self._others_present(health))
        since_ns = self._not_ready_since_ns
        self._not_ready_since_ns = {node: since_ns[node] if node in not_ready else now for node in self._own}
        limit_ns = READY_DEADLINE_S * 1e9
        late = {node: why for node, why in not_ready.items() if now - self._not_ready_since_ns[node] >= limit_ns}
        if late:
            return READY_DEADLINE_S, late
        if self._wait_s is not None and now - self._begun_ns >= self._wait_s * 1e9:
            return self._wait_s, self.waiting(health)
        return READY_DEADLINE_S, {}


def oldest_input_s(health: NodeHealth) -> float | None:
    """Return the age of the oldest input of the loop [s]; None when nothing was received.

    Reports, at 2 Hz, are left out: their age would hide that of everything else.
    """
    return max(input_ages_s(health).values(), default=None)


def input_ages_s(health: NodeHealth) -> dict[tuple[str, str], float]:
    """Return by topic and source the ages of the inputs of the loop [s], of those that were received."""
    fast = (row for row in health.inputs if row.age_valid and _rate_hz(row.topic) >= _LOOP_RATE_HZ)
    return {(row.topic, row.src): row.age_s for row in fast}


def _rate_hz(topic: str) -> float:
    """Return the declared rate [Hz]; 0 for topics sent on change, and for those that this version does not know."""
    row = row_of(topic)
    return row.rate_hz or 0.0 if row else 0.0

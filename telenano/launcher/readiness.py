"""Readiness of a rig: it is ready when every node reports that it is and receives its inputs."""

from collections.abc import Iterable, Mapping, Sequence

from telenano.settings.package_topics import row_of
from telenano.timing.clock import Clock
from telenano.wire.messages import NodeHealth

READY_DEADLINE_S = 60.0
_LOOP_RATE_HZ = 100.0


def silent_inputs(health: NodeHealth) -> list[str]:
    """Return the topics with a declared rate of which a node has received no message at any of its sockets, sorted."""
    received = {row.topic for row in health.inputs if row.age_valid}
    return sorted({row.topic for row in health.inputs if row.topic not in received and _rate_hz(row.topic) > 0.0})


def unmet(nodes: Iterable[str], health: Mapping[str, NodeHealth], *, inputs: bool = True) -> dict[str, str]:
    """Return for each node that is not ready the reason, in words; empty if all are ready.

    With `inputs` false, a node counts as ready even if it does not receive its inputs yet.
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
    """Time limits within which the nodes of a rig have to become ready.

    Each own node has a limit of 60 s. The wait for nodes elsewhere is unlimited unless `wait_s` is given; as long as
    one of them is missing, own nodes may lack inputs, because only it might send them.
    """

    def __init__(
        self, clock: Clock, own: Sequence[str], others: Sequence[str] = (), wait_s: float | None = None
    ) -> None:
        """Begin to wait for the own nodes, and for the others up to `wait_s` [s], without a limit if None."""
        self._clock = clock
        self._own = tuple(own)
        self._others = tuple(others)
        self._wait_s = wait_s
        self.reset()

    def reset(self) -> None:
        self._begun_ns = self._clock.monotonic_ns()
        # Time since which each own node has been unready through no fault of another node [ns].
        self._not_ready_since_ns = dict.fromkeys(self._own, self._begun_ns)

    def waiting(self, health: Mapping[str, NodeHealth]) -> dict[str, str]:
        """Return for each node that is not ready the reason, in words."""
        return unmet((*self._own, *self._others), health)

    def causes(self, health: Mapping[str, NodeHealth]) -> dict[str, str]:
        """Return the reasons of `waiting`, without missing inputs that a missing node elsewhere may explain."""
        return {**unmet(self._own, health, inputs=self._others_present(health)), **unmet(self._others, health)}

    def _others_present(self, health: Mapping[str, NodeHealth]) -> bool:
        return all(node in health for node in self._others)

    def overdue(self, health: Mapping[str, NodeHealth]) -> tuple[float, dict[str, str]]:
        """Return the exceeded limit [s] and the reasons of the late nodes; no nodes while there is time.

        It has to be called regularly, because it also updates the times since which nodes have been unready.
        """
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
    """Return the age of the oldest input of the loop [s]; None if nothing was received.

    Topics below 100 Hz, such as reports at 2 Hz, are left out, because their age would hide that of all others.
    """
    return max(input_ages_s(health).values(), default=None)


def input_ages_s(health: NodeHealth) -> dict[tuple[str, str], float]:
    """Return the ages of the received inputs of the loop, of at least 100 Hz [s], by topic and source."""
    fast = (row for row in health.inputs if row.age_valid and _rate_hz(row.topic) >= _LOOP_RATE_HZ)
    return {(row.topic, row.src): row.age_s for row in fast}


def _rate_hz(topic: str) -> float:
    """Return the declared rate of a topic [Hz]; 0 for topics sent on change, and for unknown topics."""
    row = row_of(topic)
    return row.rate_hz or 0.0 if row else 0.0

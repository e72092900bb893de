"""When a rig is ready: every node says so and hears what it needs."""

from collections.abc import Iterable, Mapping, Sequence

from proto import TOPICS
from proto.messages import NodeHealth
from services.runtime.clock import Clock

READY_DEADLINE_S = 60.0
_LOOP_RATE_HZ = 100.0


def silent_inputs(health: NodeHealth) -> list[str]:
    """Give the topics sent at a declared rate of which a node, at whichever of its sockets, has heard nothing."""
    heard = {row.topic for row in health.inputs if row.age_valid}
    return sorted({row.topic for row in health.inputs if row.topic not in heard and _rate_hz(row.topic) > 0.0})


def unmet(nodes: Iterable[str], health: Mapping[str, NodeHealth], *, inputs: bool = True) -> dict[str, str]:
    """Give for each node that is not ready what it waits for, in words; empty when the rig is ready.

    Without `inputs` a node is ready that hears nothing yet.
    """
    waiting: dict[str, str] = {}
    for node in nodes:
        newest = health.get(node)
        if newest is None:
            waiting[node] = "has not been heard"
        elif newest.state == "starting":
            waiting[node] = "is still starting"
        elif inputs and (silent := silent_inputs(newest)):
            waiting[node] = f"does not hear {', '.join(silent)}"
    return waiting


class ReadinessGate:
    """Who is waited for, and for how long.

    Each own node has a limit. Nodes of somebody else are waited for as long as it takes, unless a limit is given; as
    long as one of them is missing, own nodes may lack inputs that only it could send.
    """

    def __init__(
        self, clock: Clock, own: Sequence[str], others: Sequence[str] = (), wait_s: float | None = None
    ) -> None:
        """Take the nodes of this process and those of somebody else, and a limit for these [s], None for no limit."""
        self._clock = clock
        self._own = tuple(own)
        self._others = tuple(others)
        self._wait_s = wait_s
        self.restart()

    def restart(self) -> None:
        """Begin to wait anew."""
        self._begun_ns = self._clock.monotonic_ns()
        # since when each own node has been to blame for not being ready
        self._since_ns = dict.fromkeys(self._own, self._begun_ns)

    def waiting(self, health: Mapping[str, NodeHealth]) -> dict[str, str]:
        """Give for each node that is not ready what it waits for."""
        return unmet((*self._own, *self._others), health)

    def causes(self, health: Mapping[str, NodeHealth]) -> dict[str, str]:
        """Give what is really waited for: as `waiting`, without inputs that a node lacks for want of another one."""
        return {**unmet(self._own, health, inputs=self._complete(health)), **unmet(self._others, health)}

    def _complete(self, health: Mapping[str, NodeHealth]) -> bool:
        return all(node in health for node in self._others)

    def overdue(self, health: Mapping[str, NodeHealth]) -> tuple[float, dict[str, str]]:
        """Give the limit that is over [s] and those that are not ready for it; nobody while there is time."""
        now = self._clock.monotonic_ns()
        blamed = unmet(self._own, health, inputs=self._complete(health))
        self._since_ns = {node: self._since_ns[node] if node in blamed else now for node in self._own}
        late = {node: why for node, why in blamed.items() if now - self._since_ns[node] >= READY_DEADLINE_S * 1e9}
        if late:
            return READY_DEADLINE_S, late
        if self._wait_s is not None and now - self._begun_ns >= self._wait_s * 1e9:
            return self._wait_s, self.waiting(health)
        return READY_DEADLINE_S, {}


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

"""Commands of a session sent one after the other, each repeated until the nodes that it concerns have answered."""

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from proto.messages import Scalar, SessionEvent
from services.launcher.pending_command import DEADLINE_NS, Command, PendingCommand
from services.runtime.clock import Clock

# a refused command is retried for so long, with this period
_REFUSAL_RETRY_NS = 5_000_000_000
_RETRY_PERIOD_NS = 300_000_000


@dataclass(frozen=True)
class Step:
    """A command and who has to answer it; what is not `required` may fail, and the next step follows all the same."""

    command: Command
    target: str
    expected: tuple[str, ...]
    parameters: Mapping[str, Scalar] = field(default_factory=dict)
    required: bool = True
    deadline_ns: int = DEADLINE_NS


class CommandSequence:
    """Sends the commands of its steps in order.

    `failure` is the reason for which a required step failed, `tolerated_failures` holds by target those of the others.
    """

    def __init__(self, clock: Clock, publish: Callable[..., Any], steps: Iterable[Step]) -> None:
        self.failure = ""
        self.tolerated_failures: dict[str, str] = {}
        # id of each command that was answered by all
        self.ids: dict[str, str] = {}
        self._clock = clock
        self._publish = publish
        self._steps = deque(steps)
        self._step: Step | None = None
        self._pending: PendingCommand | None = None
        self._retry_until_ns = self._next_retry_ns = 0

    def on_event(self, event: SessionEvent) -> None:
        if self._pending is not None:
            self._pending.record(event)

    def advance(self) -> bool:
        """Send what is due; True once every step is complete or a required one has failed."""
        while not self.failure:
            if self._step is None:
                if not self._steps:
                    return True
                self._begin(self._steps.popleft())
            if not self._step_over():
                return False
        return True

    def _begin(self, step: Step) -> None:
        self._step = step
        self._retry_until_ns = self._clock.monotonic_ns() + _REFUSAL_RETRY_NS
        self._issue(step)

    def _issue(self, step: Step) -> None:
        self._pending = PendingCommand(
            self._clock, step.command, step.target, step.expected, step.parameters, step.deadline_ns
        )

    def _step_over(self) -> bool:
        step, pending = self._step, self._pending
        if step is None or pending is None:
            return True
        if failure := pending.failure():
            return self._handle_failure(step, pending, failure)
        if pending.complete:
            self.ids[step.command] = pending.id
            self._step = self._pending = None
            return True
        if pending.take_due():
            self._publish("session/control", **pending.fields())
        return False

    def _handle_failure(self, step: Step, pending: PendingCommand, failure: str) -> bool:
        """Return whether the step is over.

        A refused required command is retried for a while: the first fresh command of a device may still be on the way.
        """
        now = self._clock.monotonic_ns()
        if step.required and pending.refusals and now < self._retry_until_ns:
            if now >= self._next_retry_ns:
                self._issue(step)
                self._next_retry_ns = now + _RETRY_PERIOD_NS
            return False
        if step.required:
            self.failure = failure
        else:
            self.tolerated_failures[step.target] = failure
        self._step = self._pending = None
        return True

"""Commands of a session one after the other, each repeated until those that it concerns have answered."""

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from proto.messages import Scalar, SessionEvent
from services.launcher.pending_command import DEADLINE_NS, Command, PendingCommand
from services.runtime.clock import Clock

# a refusal is asked about again for so long, so often
_REFUSAL_PATIENCE_NS = 5_000_000_000
_ASK_AGAIN_NS = 300_000_000


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
    """Takes steps in order.

    `failure` says which required one failed, `complaints` by target which of the others did.
    """

    def __init__(self, clock: Clock, publish: Callable[..., Any], steps: Iterable[Step]) -> None:
        self.failure = ""
        self.complaints: dict[str, str] = {}
        # id of each command that was answered by all
        self.ids: dict[str, str] = {}
        self._clock = clock
        self._publish = publish
        self._steps = deque(steps)
        self._step: Step | None = None
        self._pending: PendingCommand | None = None
        self._patient_until_ns = self._ask_again_ns = 0

    def enter(self, event: SessionEvent) -> None:
        """Take what a node said."""
        if self._pending is not None:
            self._pending.enter(event)

    def advance(self) -> bool:
        """Send what is due; True once every step is through or a required one has failed."""
        while not self.failure:
            if self._step is None:
                if not self._steps:
                    return True
                self._begin(self._steps.popleft())
            if not self._settled():
                return False
        return True

    def _begin(self, step: Step) -> None:
        self._step = step
        self._patient_until_ns = self._clock.monotonic_ns() + _REFUSAL_PATIENCE_NS
        self._ask(step)

    def _ask(self, step: Step) -> None:
        self._pending = PendingCommand(
            self._clock, step.command, step.target, step.expected, step.parameters, step.deadline_ns
        )

    def _settled(self) -> bool:
        step, pending = self._step, self._pending
        if step is None or pending is None:
            return True
        if failure := pending.failure():
            return self._failed(step, pending, failure)
        if pending.complete:
            self.ids[step.command] = pending.id
            self._step = self._pending = None
            return True
        if pending.take_due():
            self._publish("session/control", **pending.fields())
        return False

    def _failed(self, step: Step, pending: PendingCommand, failure: str) -> bool:
        """Give a device some time to become able: its first fresh command may still be on the way."""
        now = self._clock.monotonic_ns()
        if step.required and pending.refusals and now < self._patient_until_ns:
            if now >= self._ask_again_ns:
                self._ask(step)
                self._ask_again_ns = now + _ASK_AGAIN_NS
            return False
        if step.required:
            self.failure = failure
        else:
            self.complaints[step.target] = failure
        self._step = self._pending = None
        return True

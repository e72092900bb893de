"""A session/control that waits for answers: sent again with the same id until every node addressed has answered."""

import uuid
from collections.abc import Iterable, Mapping
from typing import Any, Literal

from proto.messages import Scalar, SessionEvent
from services.runtime.clock import Clock

Command = Literal["start", "stop", "arm", "estop", "set", "mark"]
RESEND_NS = 200_000_000
DEADLINE_NS = 5_000_000_000


class PendingCommand:
    """One command and the answers so far. Nodes carry it out once and answer each time that they receive it."""

    def __init__(
        self,
        clock: Clock,
        command: Command,
        target: str,
        expected: Iterable[str],
        parameters: Mapping[str, Scalar] | None = None,
        deadline_ns: int = DEADLINE_NS,
    ) -> None:
        """Prepare a command for `target`; `expected` are the nodes (node@site) that have to answer."""
        self.command = command
        self.target = target
        self.expected = set(expected)
        self.answers: dict[str, SessionEvent] = {}
        self.id = uuid.uuid4().hex
        self._parameters = dict(parameters or {})
        self._clock = clock
        self._next_ns = clock.monotonic_ns()
        self._deadline_ns = self._next_ns + deadline_ns

    def fields(self) -> dict[str, Any]:
        return {"id": self.id, "command": self.command, "target": self.target, "parameters": self._parameters}

    def take_due(self) -> bool:
        """Return whether the command is to be sent now, and schedule the next sending if so."""
        now = self._clock.monotonic_ns()
        if self.complete or now < self._next_ns:
            return False
        self._next_ns = now + RESEND_NS
        return True

    def make_due(self) -> None:
        """Schedule the next sending for now: a new reader has connected."""
        self._next_ns = self._clock.monotonic_ns()

    def record(self, event: SessionEvent) -> bool:
        """Record an event; True when it is a node's first answer to this command."""
        answers_this = event.id == self.id and event.kind in ("ack", "refused")
        if not answers_this or event.src in self.answers:
            return False
        self.answers[event.src] = event
        return True

    @property
    def missing(self) -> list[str]:
        return sorted(self.expected - set(self.answers))

    @property
    def refusals(self) -> list[SessionEvent]:
        return [event for event in self.answers.values() if event.kind == "refused"]

    @property
    def complete(self) -> bool:
        return not self.missing

    @property
    def expired(self) -> bool:
        return self._clock.monotonic_ns() >= self._deadline_ns

    def failure(self) -> str:
        """Return why the command failed, as a sentence; empty while it may still succeed, and when it has."""
        if self.refusals:
            return "; ".join(f"{event.src} refused {self.command}: {event.text}" for event in self.refusals)
        if self.expired and not self.complete:
            return f"{', '.join(self.missing)} did not answer {self.command} in time"
        return ""

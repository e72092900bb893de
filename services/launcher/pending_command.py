"""A session/control on its way: sent again with the same id until every node addressed has answered."""

import uuid
from collections.abc import Iterable, Mapping
from typing import Any, Literal

from proto.messages import Scalar, SessionEvent
from services.runtime.clock import Clock

Command = Literal["start", "stop", "arm", "estop", "set", "mark"]
RESEND_NS = 200_000_000
DEADLINE_NS = 5_000_000_000


class PendingCommand:
    """One command and the answers so far. Nodes carry it out once and answer each time that they hear it."""

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
        """Give the fields of the message."""
        return {"id": self.id, "command": self.command, "target": self.target, "parameters": self._parameters}

    def take_due(self) -> bool:
        """Say whether it is to be sent now, and set the time of the next sending if so."""
        now = self._clock.monotonic_ns()
        if self.complete or now < self._next_ns:
            return False
        self._next_ns = now + RESEND_NS
        return True

    def hurry(self) -> None:
        """Have it sent at once, because a reader has just come."""
        self._next_ns = self._clock.monotonic_ns()

    def enter(self, event: SessionEvent) -> bool:
        """Take an event; True when it is a node's first answer to this command."""
        answers_this = event.id == self.id and event.kind in ("ack", "refused")
        if not answers_this or event.src in self.answers:
            return False
        self.answers[event.src] = event
        return True

    @property
    def missing(self) -> list[str]:
        """The nodes that have not answered yet."""
        return sorted(self.expected - set(self.answers))

    @property
    def refusals(self) -> list[SessionEvent]:
        """The answers of those that refused."""
        return [event for event in self.answers.values() if event.kind == "refused"]

    @property
    def complete(self) -> bool:
        """All that are expected have answered."""
        return not self.missing

    @property
    def expired(self) -> bool:
        """The time for answers is over."""
        return self._clock.monotonic_ns() >= self._deadline_ns

    def failure(self) -> str:
        """Give in a sentence why the command failed; empty while it may still succeed, and when it has."""
        if self.refusals:
            return "; ".join(f"{event.src} refused {self.command}: {event.text}" for event in self.refusals)
        if self.expired and not self.complete:
            return f"{', '.join(self.missing)} did not answer {self.command} in time"
        return ""

"""Commands on the bus: `CommandClient` sends them and collects the answers, `CommandHandler` takes them in a node.

A command is a `session/control`, its answers are `session/event`s of the same id. The client sends it again with the
same id until all have answered; a node carries an id out once and answers each time that it receives it.
"""

import os
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any, Literal

from proto.errors import TelenanoError
from proto.messages import Scalar, SessionControl, SessionEvent
from proto.nodes import name_of
from services.runtime.clock import Clock

CommandName = Literal["start", "stop", "arm", "estop", "set", "mark"]

RESEND_NS = 200_000_000
DEADLINE_NS = 5_000_000_000
_RETRY_PERIOD_NS = 300_000_000
# every node is heard within two of its reports
_CENSUS_NS = 1_200_000_000
# quiet after the last answer to a pattern: whoever knows the command has answered
_QUIET_NS = 500_000_000
_REMEMBERED_ANSWERS = 256


@dataclass(frozen=True)
class Command:
    """A command and the nodes (node@site) that have to answer it; without any, whoever of a pattern knows it answers.

    What is not `required` may fail, and the next command follows all the same.
    """

    name: CommandName
    target: str
    expected: tuple[str, ...] = ()
    parameters: Mapping[str, Scalar] = field(default_factory=dict)
    required: bool = True
    deadline_ns: int = DEADLINE_NS


class CommandClient:
    """Sends commands one after the other, each until it is answered, refused for good, or out of time.

    Of a pattern nobody knows beforehand who knows the command: answers are awaited for as long as a node that is alive
    may be silent, and then until no more come.

    `failure` says why a required command failed, `tolerated_failures` holds by target the reasons of the others.
    `answers` are those of the last command by node, refusals among them; `ids` has the id of each answered command.
    """

    def __init__(
        self, clock: Clock, publish: Callable[..., Any], commands: Iterable[Command], *, retry_ns: int = 0
    ) -> None:
        """Prepare to send `commands`; a refused one that is required is tried anew for `retry_ns` [ns]."""
        self.failure = ""
        self.tolerated_failures: dict[str, str] = {}
        self.ids: dict[str, str] = {}
        self.answers: dict[str, SessionEvent] = {}
        self._clock = clock
        self._publish = publish
        self._commands = deque(commands)
        self._retry_ns = retry_ns
        # random, and no time in it: ids of two senders differ whatever their clocks say
        self._sender = os.urandom(8).hex()
        self._issued = 0
        self._command: Command | None = None
        self._id = ""
        self._begun_ns = self._issued_ns = self._next_ns = self._last_answer_ns = 0

    def advance(self) -> bool:
        """Send what is due; return whether every command is over, or a required one has failed."""
        while not self.failure:
            if self._command is None:
                if not self._commands:
                    return True
                self._begun_ns = self._clock.monotonic_ns()
                self._issue(self._commands.popleft())
            if not self._advance(self._command):
                return False
        return True

    def on_event(self, event: SessionEvent) -> bool:
        """Record an event; return whether it is a node's first answer to the command in hand."""
        if event.id != self._id or event.kind not in ("ack", "refused") or event.src in self.answers:
            return False
        self.answers[event.src] = event
        self._last_answer_ns = self._clock.monotonic_ns()
        return True

    def make_due(self) -> None:
        """Send the command in hand again at once: a new reader has connected."""
        self._next_ns = self._clock.monotonic_ns()

    @property
    def refusals(self) -> list[SessionEvent]:
        return [event for event in self.answers.values() if event.kind == "refused"]

    def _issue(self, command: Command) -> None:
        self._command, self._id, self.answers = command, f"{self._sender}-{self._issued}", {}
        self._issued += 1
        self._issued_ns = self._next_ns = self._last_answer_ns = self._clock.monotonic_ns()

    def _advance(self, command: Command | None) -> bool:
        """Return whether the command in hand is over."""
        if command is None:
            return True
        now = self._clock.monotonic_ns()
        if self._answered(command, now) or now - self._issued_ns >= command.deadline_ns:
            return self._conclude(command, now)
        if now >= self._next_ns:
            self._next_ns = now + RESEND_NS
            self._publish(
                "session/control",
                id=self._id,
                command=command.name,
                target=command.target,
                parameters=dict(command.parameters),
            )
        return False

    def _answered(self, command: Command, now_ns: int) -> bool:
        if command.expected:
            return set(command.expected) <= set(self.answers)
        settled = now_ns - self._issued_ns >= _CENSUS_NS and now_ns - self._last_answer_ns >= _QUIET_NS
        return settled and bool(self.answers)

    def _conclude(self, command: Command, now_ns: int) -> bool:
        """Take the outcome of a command; return whether it is over, and not to be tried anew."""
        failure = self._reason(command)
        if not failure:
            self.ids[command.name] = self._id
        elif not command.required:
            self.tolerated_failures[command.target] = failure
        elif self.refusals and now_ns - self._begun_ns < self._retry_ns:
            # the first fresh command of a device may still be on the way
            if now_ns - self._issued_ns >= _RETRY_PERIOD_NS:
                self._issue(command)
            return False
        else:
            self.failure = failure
        self._command = None
        return True

    def _reason(self, command: Command) -> str:
        """Return why a command failed, as a sentence; empty when it did not."""
        missing = sorted(set(command.expected) - set(self.answers))
        reasons = [f"{event.src} refused {command.name}: {event.text}" for event in self.refusals]
        if missing:
            reasons.append(f"{', '.join(missing)} did not answer {command.name} in time")
        elif not self.answers:
            reasons.append(f"no node answered {command.name}")
        return "; ".join(reasons)


class CommandHandler:
    """Takes session/control for a node: once per id, with the answer repeated to a command that is sent again."""

    def __init__(
        self,
        node: str,
        known: Sequence[str],
        carry_out: Callable[[SessionControl], str],
        event: Callable[..., None],
    ) -> None:
        """Take commands for `node` (node@site).

        Parameters: known, commands that it answers when a pattern matches it; carry_out, returns a sentence for the
        answer or raises RefusedError; event, publishes a session/event.
        """
        self._node = node
        self._known = frozenset(known)
        self._carry_out = carry_out
        self._event = event
        self._answers: OrderedDict[str, tuple[str, str, str]] = OrderedDict()

    def handle(self, control: SessionControl) -> bool:
        """Carry out a command if it concerns this node, and answer with a session/event of the same id.

        Returns: whether the node was asked now, rather than its answer repeated.
        """
        if not is_meant(self._node, control.target):
            return False
        if is_pattern(control.target) and control.command not in self._known:
            return False
        is_new = control.id not in self._answers
        if is_new:
            self._answers[control.id] = self._answer(control)
            if len(self._answers) > _REMEMBERED_ANSWERS:
                self._answers.popitem(last=False)
        kind, level, text = self._answers[control.id]
        self._event(kind, level, text, answer_to=control.id, command=control.command)
        return is_new

    def _answer(self, control: SessionControl) -> tuple[str, str, str]:
        try:
            return "ack", "info", self._carry_out(control)
        except TelenanoError as error:
            return "refused", "warning", str(error)


def is_meant(node: str, target: str) -> bool:
    """Return whether a target means a node (node@site): by its full name, its name at every site, or a pattern."""
    return fnmatchcase(node, target) or fnmatchcase(name_of(node), target)


def is_pattern(target: str) -> bool:
    """Return whether a target is a pattern: a node that one matches keeps silent about commands it does not know."""
    return any(sign in target for sign in "*?[")

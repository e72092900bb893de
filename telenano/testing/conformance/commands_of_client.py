"""Checks of a client that sends commands: its reactions to nodes that answer late, refuse and acknowledge."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from telenano.testing.conformance.rules import Account

_MS = 1_000_000
# Time for which the first copies of a command are not answered, so that it must be repeated.
SILENT_NS = 500 * _MS
# Time in which the client must quote a refusal in the next copy of its command.
QUOTED_NS = 1500 * _MS
# Time in which the client must stop repeating a command after its acknowledgement.
ENDED_NS = 300 * _MS
# Most stored commands, so that a client cannot fill the memory; a person gives some tens.
_MOST_COMMANDS = 1000
LATCH = "0a1b2c3d4e5f-1"
# Commands that never expire.
_AT_ONCE = ("estop", "stop")
# Publishes a session/event of a node, and returns its t_ns.
Answers = Callable[[str, dict[str, Any]], int]


@dataclass
class _Command:
    """A command with an id: its first copy, times [ns since 1970], and the phase of its answer."""

    first: dict[str, Any]
    node: str
    first_ns: int
    t_ns: int
    # The first ack has a key that the client does not know; the second one, if it is needed, is plain.
    phase: Literal["silent", "refused", "acknowledged", "acknowledged plainly", "ended"] = "silent"
    phase_ns: int = 0
    copies: int = 1
    answered_ns: int = 0
    quoted: set[str] = field(default_factory=set)


class CommandsOfClient:
    """Examines the commands of a client.

    Args:
        account: Records the findings.
        answers: Publishes an answer; None if the client does not read from the kit.
    """

    def __init__(self, account: Account, answers: Answers | None) -> None:
        self._account, self._answers = account, answers
        self._commands: dict[str, _Command] = {}

    def take(self, fields: dict[str, Any], now_ns: int) -> None:
        """Examine a session/control that came at a time [ns since 1970]."""
        identifier, account = fields.get("id"), self._account
        if not isinstance(identifier, str) or not isinstance(fields.get("target"), str):
            return
        command = self._commands.get(identifier)
        if command is None and len(self._commands) >= _MOST_COMMANDS:
            account.fail("identifiers", f"more than {_MOST_COMMANDS} commands come within the examination")
            return
        if command is None:
            self._commands[identifier] = _Command(fields, _node_of(fields["target"]), now_ns, fields["t_ns"])
            return
        if any(fields.get(key) != command.first.get(key) for key in ("command", "target", "parameters")):
            account.fail("identifiers", f"the id {identifier} is that of two commands")
            return
        account.hold("identifiers")
        if fields["t_ns"] <= command.t_ns:
            account.fail("repetition", f"{identifier} comes again with the t_ns of before")
        command.t_ns = fields["t_ns"]
        command.copies += 1
        if command.phase == "silent":
            account.hold("repetition")
        elif command.phase == "refused":
            self._quotations(identifier, command, fields)
        elif now_ns - command.phase_ns > ENDED_NS and command.phase == "acknowledged":
            self._acknowledge(identifier, command, now_ns, plainly=True)
        elif now_ns - command.phase_ns > ENDED_NS:
            account.fail("end of repetition", f"{identifier} is sent again after its ack")
            command.phase = "ended"

    def tick(self, now_ns: int) -> None:
        """Send the answers that are due at a time [ns since 1970]."""
        for identifier, command in self._commands.items():
            if command.phase == "silent" and now_ns - command.first_ns >= SILENT_NS:
                if command.copies == 1:
                    text = f"{identifier} has no answer for {SILENT_NS / 1e9:g} s, and is not sent again"
                    self._account.fail("repetition", text)
                if self._answers is not None:
                    self._refuse_or_take(identifier, command, now_ns)
            elif command.phase == "refused" and (self._is_quoted(command) or now_ns - command.phase_ns >= QUOTED_NS):
                self._miss_quotations(identifier, command)
                self._acknowledge(identifier, command, now_ns)
            elif command.phase.startswith("acknowledged") and now_ns - command.phase_ns >= 2 * ENDED_NS:
                if command.phase == "acknowledged":
                    self._account.hold("unknown keys")
                else:
                    self._account.fail("unknown keys", f"the ack of {identifier} was taken without further_k alone")
                command.phase = "ended"
                self._account.hold("end of repetition", "identifiers")

    def _refuse_or_take(self, identifier: str, command: _Command, now_ns: int) -> None:
        assert self._answers is not None
        if command.first["command"] in _AT_ONCE:
            self._acknowledge(identifier, command, now_ns)
            return
        data: dict[str, Any] = {"expired": True}
        text = "the command is too old by this node's clock"
        if command.first["command"] == "arm":
            data |= {"latch": LATCH, "estop_age_s": 3600.0, "latched": False}
        answer = {"id": identifier, "kind": "refused", "level": "warning", "text": text, "data": data}
        command.answered_ns = self._answers(command.node, answer)
        command.phase, command.phase_ns = "refused", now_ns

    def _acknowledge(self, identifier: str, command: _Command, now_ns: int, *, plainly: bool = False) -> None:
        if self._answers is not None:
            answer = {"id": identifier, "kind": "ack", "level": "info", "text": "done", "data": {}}
            self._answers(command.node, answer if plainly else answer | {"further_k": 295.0})
        command.phase, command.phase_ns = "acknowledged plainly" if plainly else "acknowledged", now_ns

    def _wanted(self, command: _Command) -> dict[str, tuple[str, Any]]:
        """Return the required quotations by rule: the key, and the value for the node."""
        wanted: dict[str, tuple[str, Any]] = {"quoted clock": ("node_t_ns", command.answered_ns)}
        return wanted | ({"quoted stop": ("node_latch", LATCH)} if command.first["command"] == "arm" else {})

    def _quotations(self, identifier: str, command: _Command, fields: dict[str, Any]) -> None:
        for rule, (key, value) in self._wanted(command).items():
            quoted = fields.get(key)
            if not isinstance(quoted, dict) or command.node not in quoted:
                continue
            command.quoted.add(rule)
            if quoted[command.node] == value or (key == "node_t_ns" and quoted[command.node] > value):
                self._account.hold(rule)
            else:
                self._account.fail(rule, f"{identifier} quotes {quoted[command.node]} in {key}, and not {value}")

    def _is_quoted(self, command: _Command) -> bool:
        return command.quoted >= self._wanted(command).keys()

    def _miss_quotations(self, identifier: str, command: _Command) -> None:
        for rule, (key, _) in self._wanted(command).items():
            if rule not in command.quoted:
                self._account.fail(rule, f"{identifier} was refused by {command.node}, and does not come with {key}")


def _node_of(target: str) -> str:
    """Return a node that a target addresses: itself, or one of the table that has this name or matches the pattern."""
    if "@" in target and not any(mark in target for mark in "*?["):
        return target
    return f"{target}@master" if target in ("controller", "haptic_node", "delay_node") else "afm_node@slave"

"""Checks of a client that acts as a node: sends it commands that move nothing, and examines its answers.

The command is `mark`, which is only for recorders; every other node refuses it, so no device moves.
"""

from collections.abc import Callable
from typing import Any

from telenano.testing.conformance.rules import Account

_S = 1_000_000_000
# Time within which a command must be answered.
_ANSWER_NS = _S
# Time after which a command that must not be answered counts as unanswered.
_QUIET_NS = _S // 2
# Age of a command that has expired.
_OLD_NS = 10 * _S
# Publishes a session/control with these fields, and a t_ns that lies an age [ns] in the past.
Commands = Callable[[dict[str, Any], int], None]


class AnswersOfClient:
    """Examines the answers of a node, one test command after the other.

    Args:
        account: Records the findings.
        commands: Publishes a command.
        disturb: Publishes messages that break the rules, or are of a later version.
    """

    def __init__(self, account: Account, commands: Commands, disturb: Callable[[], None]) -> None:
        self._account, self._commands, self._disturb = account, commands, disturb
        self._node = ""
        self._step, self._asked_ns = -1, 0
        self._first: dict[str, Any] | None = None
        self._answer: dict[str, Any] | None = None
        self._steps = (self._by_name, self._again, self._expired, self._unknown_key, self._others, self._disturbed)

    @property
    def done(self) -> bool:
        """Whether every test command was sent and judged."""
        return self._step >= len(self._steps)

    def begin(self, node: str, now_ns: int) -> None:
        """Send the first test command to a node at a time [ns since 1970]; a second call does nothing."""
        if not self._node:
            self._node = node
            self._next(now_ns)

    def take(self, fields: dict[str, Any]) -> None:
        """Examine a session/event of the client."""
        if 0 <= self._step < len(self._steps) and fields.get("id") == self._identifier:
            self._answer = fields

    def tick(self, now_ns: int) -> None:
        """Judge the answer or its absence at a time [ns since 1970], and send the next test command."""
        if not self._node or self.done:
            return
        waits_for_none = self._steps[self._step] in (self._unknown_key, self._others)
        since_ns = now_ns - self._asked_ns
        if since_ns >= (_QUIET_NS if waits_for_none else _ANSWER_NS) or (self._answer and not waits_for_none):
            self._steps[self._step](self._answer)
            self._next(now_ns)

    @property
    def _identifier(self) -> str:
        # The second test command repeats the first one.
        return f"kit-{0 if self._step == 1 else self._step}"

    def _next(self, now_ns: int) -> None:
        self._step, self._answer, self._asked_ns = self._step + 1, None, now_ns
        if self.done:
            return
        asked: dict[str, Any] = {"id": self._identifier, "command": "mark", "target": self._node, "parameters": {}}
        step = self._steps[self._step]
        if step == self._unknown_key:
            asked["dry_run"] = True
        elif step == self._others:
            asked["target"] = "absent@slave"
        elif step == self._disturbed:
            self._disturb()
        self._commands(asked, _OLD_NS if step == self._expired else 0)

    def _by_name(self, answer: dict[str, Any] | None) -> None:
        self._first = answer
        if answer is None:
            self._account.fail("answer", f"{self._node} does not answer a mark to it within 1 s")
        elif answer.get("kind") not in ("ack", "refused"):
            self._account.fail("answer", f"{self._node} answers a mark by {answer.get('kind')!r}")
        else:
            self._account.hold("answer")

    def _again(self, answer: dict[str, Any] | None) -> None:
        words = [None if each is None else (each.get("kind"), each.get("text")) for each in (self._first, answer)]
        if words[0] is not None and words[0] == words[1]:
            self._account.hold("same answer")
        elif words[0] is not None:
            self._account.fail("same answer", f"{words[0]} at first, and then {words[1]}")

    def _expired(self, answer: dict[str, Any] | None) -> None:
        data = (answer or {}).get("data")
        if answer is None:
            self._account.fail("expired command", "a command that is 10 s old is not answered")
        elif answer.get("kind") == "refused" and isinstance(data, dict) and data.get("expired") is True:
            self._account.hold("expired command")
        else:
            self._account.fail("expired command", f"a command that is 10 s old has the answer {answer.get('kind')!r}")

    def _unknown_key(self, answer: dict[str, Any] | None) -> None:
        if answer is not None and answer.get("kind") == "ack":
            self._account.fail("unknown command key", "a command with the key dry_run is acknowledged")
        else:
            self._account.hold("unknown command key")

    def _others(self, answer: dict[str, Any] | None) -> None:
        if answer is None:
            self._account.hold("others' commands")
        else:
            self._account.fail("others' commands", f"a command to absent@slave is answered by {answer.get('src')}")

    def _disturbed(self, answer: dict[str, Any] | None) -> None:
        if answer is not None:
            self._account.hold("robustness")
        elif self._first is not None:
            self._account.fail("robustness", "no command is answered after messages that break the rules")

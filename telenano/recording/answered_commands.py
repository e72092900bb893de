"""Which commands a recording shows: by their own message, or by an answer that repeats them.

A console leaves as soon as it has its answers, perhaps before a recorder has connected to it. The node that answers is
connected for the whole session, so the recording has the answer, and with it the command. An answer of an earlier
version has only the name of the command: such a command is missing, and named.
"""

from collections.abc import Mapping
from typing import Any

from telenano.wire.answers import is_answer, read_answer

COMMAND_TOPIC = "session/control"
ANSWER_TOPIC = "session/event"
# Most missing commands that are named; further ones are counted.
_MOST_NAMED = 5


class AnsweredCommands:
    """The commands and answers of a recording, by id; the answer may come before the command."""

    def __init__(self) -> None:
        # Ids of the commands whose own message is in the recording.
        self._recorded: set[str] = set()
        # Whether an answer repeats the command, by its id.
        self._repeated: dict[str, bool] = {}
        # Name of the command and the node that answered it first, by id.
        self._answered: dict[str, tuple[str, str]] = {}

    def add(self, topic: str, fields: Mapping[str, Any]) -> None:
        """Add the unchecked fields of a session/control or a session/event; of other topics nothing is added."""
        if topic == COMMAND_TOPIC:
            self._recorded.add(str(fields.get("id")))
        elif topic == ANSWER_TOPIC and is_answer(fields):
            identifier, data = fields["id"], fields.get("data")
            name = data.get("command") if isinstance(data, Mapping) else None
            self._answered.setdefault(identifier, (str(name or "command"), str(fields.get("src"))))
            self._repeated[identifier] = self._repeated.get(identifier, False) or read_answer(fields) is not None

    @property
    def answered(self) -> int:
        """Number of commands that were answered."""
        return len(self._answered)

    @property
    def by_answer_alone(self) -> int:
        """Number of commands whose own message is missing, and which an answer repeats."""
        return sum(self._repeated[identifier] for identifier in self._answered.keys() - self._recorded)

    def missing(self) -> tuple[str, ...]:
        """Return a sentence for each answered command that the recording does not show; the last one counts the rest.

        A recording made from a part of another one may lack the commands of its first answers.
        """
        lost = [
            (identifier, *named)
            for identifier, named in self._answered.items()
            if identifier not in self._recorded and not self._repeated[identifier]
        ]
        named = [
            f"the command {name} ({identifier}) that {node} answered is missing" for identifier, name, node in lost
        ]
        rest = len(named) - _MOST_NAMED
        return (*named[:_MOST_NAMED], *([f"{rest} further answered commands are missing"] if rest > 0 else []))

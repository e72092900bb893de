"""What became of a command at each node that was asked: one type for the command, JSON, Python and the page.

    rows = emergency_stop(rig, reach, "*", print)
    if not all_acknowledged(rows):
        ...

The nodes that are asked follow from the site file and the target alone. Each of them has a row, whatever became of it,
and a command has succeeded only if all rows are acknowledgements. The module imports no models, because an emergency
stop has no time for them.
"""

from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

from telenano.wire.errors import RigError

Kind = Literal["ack", "refused", "kept", "absent", "unreached"]
# What the kinds mean, for people.
MEANINGS: dict[Kind, str] = {
    "ack": "acknowledged",
    "refused": "refused",
    "kept": "kept for it: it obeys as soon as it can",
    "absent": "absent: it does not run",
    "unreached": "out of reach: it has not answered, and whether it obeys is not known",
}


class Answer(NamedTuple):
    """What became of a command at a node.

    `kind` is ack or refused if the node answered; else kept if it will find the command when it can, absent if it does
    not run, and unreached if it may run and has not answered. `last_seen` is a sentence on the last known state of a
    device that has not answered; empty if none is known or it was not looked up.
    """

    node: str
    kind: str
    text: str
    last_seen: str = ""

    @property
    def sentence(self) -> str:
        """The text, with the last known state if there is one."""
        return f"{self.text}; {self.last_seen}" if self.last_seen else self.text

    def row(self) -> dict[str, Any]:
        """Return the answer without its node, for JSON."""
        return {"kind": self.kind, "text": self.text, **({"last_seen": self.last_seen} if self.last_seen else {})}


def kind_of(event_kind: str) -> Kind:
    """Return the kind of the row of a node that has answered, from the kind of its event.

    The report that the tip is placed follows the acknowledgement of the command and takes its place.
    """
    return "refused" if event_kind == "refused" else "ack"


def all_acknowledged(answers: Mapping[str, Answer]) -> bool:
    """Return whether nodes were asked and all have acknowledged; exit code and page depend on nothing else."""
    return bool(answers) and all(answer.kind == "ack" for answer in answers.values())


def unacknowledged(answers: Mapping[str, Answer]) -> str:
    """Return a sentence on the nodes that have neither acknowledged nor refused; empty if there are none."""
    silent = [answer for _, answer in sorted(answers.items()) if answer.kind not in ("ack", "refused")]
    return "; ".join(f"{answer.node} {answer.sentence}" for answer in silent)


class UnansweredError(RigError):
    """A command that not all who were asked have answered; `answers` has a row for each of them."""

    def __init__(self, text: str, answers: Mapping[str, Answer]) -> None:
        super().__init__(text)
        self.answers = dict(answers)

    @property
    def facts(self) -> dict[str, Any]:
        """The rows for JSON, beside the text."""
        return {"answers": {node: answer.row() for node, answer in sorted(self.answers.items())}}

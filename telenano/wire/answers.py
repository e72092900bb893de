"""The command that an answer repeats in its data, so that a recording has each command that was answered.

The sender of a command comes and goes, and may have left before a recorder has connected to it. The node that answers
is connected for the whole session, and a lost answer is a gap in its numbers.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from telenano.wire.messages import Scalar

# Key of the data of the link's report that a device of the other site has obeyed the stop with this id.
OBEYED = "obeyed"
_PREFIX = "parameters."
_LEFT_OUT = "parameters_left_out"
# Most parameters that an answer repeats; with the other data they stay below the 1024 keys of a map.
_MOST_PARAMETERS = 900


class AnsweredCommand(NamedTuple):
    """A command as its answer repeats it; `sent_t_ns` is the time of the copy that was answered [ns]."""

    id: str
    command: str
    target: str
    giver: str
    sent_t_ns: int
    by: str
    parameters: "dict[str, Scalar]"


def parameter_data(parameters: "Mapping[str, Scalar]") -> "dict[str, Scalar]":
    """Return the data of an answer for the parameters of its command, or their number if there are too many."""
    if len(parameters) > _MOST_PARAMETERS:
        return {_LEFT_OUT: len(parameters)}
    return {f"{_PREFIX}{key}": value for key, value in parameters.items()}


def is_answer(fields: Mapping[str, Any]) -> bool:
    """Return whether the unchecked fields of a session/event answer a command."""
    return fields.get("kind") in ("ack", "refused") and isinstance(fields.get("id"), str) and fields["id"] != ""


def read_answer(fields: Mapping[str, Any]) -> AnsweredCommand | None:
    """Return the command that an answer repeats.

    None if the event answers no command, or does not repeat it as a whole: earlier versions have only its name, and of
    too many parameters an answer has only the number.

    Args:
        fields: The unchecked fields of a session/event.
    """
    data = fields.get("data")
    if not is_answer(fields) or not isinstance(data, Mapping) or _LEFT_OUT in data:
        return None
    texts = [data.get(key) for key in ("command", "target", "giver")]
    sent_t_ns = data.get("sent_t_ns")
    if not all(isinstance(text, str) for text in texts) or type(sent_t_ns) is not int:
        return None
    given = {str(key): value for key, value in data.items()}
    parameters = {key.removeprefix(_PREFIX): value for key, value in given.items() if key.startswith(_PREFIX)}
    command, target, giver = map(str, texts)
    return AnsweredCommand(str(fields["id"]), command, target, giver, sent_t_ns, str(data.get("by", "")), parameters)

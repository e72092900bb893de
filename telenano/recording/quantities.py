"""Units and descriptions of the columns of a message table, from the declared models of the messages."""

import re
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import msgspec

from telenano.recording.records import RECORDS
from telenano.settings.package_topics import row_of
from telenano.wire.messages import Record
from telenano.wire.schema import records_in

# "Base position [m]; z = -x_s", "Time [s], 0 = none"
_UNIT = re.compile(r"\[([^\[\]0-9]+)\]")
_RECORD = {
    "log_ns": ("ns", "Recorder's clock at the reception"),
    "publish_ns": ("ns", "Publisher's clock at the sending"),
}


class Quantity(NamedTuple):
    """Unit (empty if there is none) and description of a column."""

    unit: str
    description: str


def model_of(topic: str) -> type[Record] | None:
    """Return the message model of a topic; None if this version does not know the topic."""
    return RECORDS.get(topic) or (row.model if (row := row_of(topic)) else None)


def quantity(topic: str, column: str) -> Quantity:
    """Return unit and description of a topic's column, such as `tip_force_n.2`; both empty if unknown."""
    return _quantities(model_of(topic)).get(_without_index(column), Quantity("", ""))


def _without_index(column: str) -> str:
    name, _, last = column.rpartition(".")
    return name if last.isdecimal() else column


@cache
def _quantities(model: type[Record] | None) -> dict[str, Quantity]:
    quantities = {name: Quantity(*facts) for name, facts in _RECORD.items()}
    return quantities if model is None else quantities | dict(_of_model(model, ""))


def _of_model(model: type[Record], prefix: str) -> Iterator[tuple[str, Quantity]]:
    for field in msgspec.structs.fields(model):
        text = next((rule.description for rule in getattr(field.type, "__metadata__", ()) if rule.description), "")
        unit = _UNIT.search(text)
        yield prefix + field.name, Quantity(unit[1] if unit else "", text)
        for part in records_in(field.type):
            yield from _of_model(part, f"{prefix}{field.name}.")

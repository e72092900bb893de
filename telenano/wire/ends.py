"""The end message of a publisher, a session/event whose data count the messages that it sent on each topic.

A reader that received fewer knows that it lacks the last ones, which no later sequence number would reveal.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from telenano.wire.messages import Scalar

END_TOPIC = "session/event"
_STATE = "ended"
_PREFIX = "sent."


def end_data(sent: Mapping[str, int], forwarded: Mapping[tuple[str, str], int] | None = None) -> "dict[str, Scalar]":
    """Return the data of the event.

    Args:
        sent: The number of messages sent on each topic, including this event.
        forwarded: The seq after the newest forwarded message, by topic and source.
    """
    own = {f"{_PREFIX}{topic}": count for topic, count in sent.items()}
    others = {f"{_PREFIX}{topic}.{src}": count for (topic, src), count in (forwarded or {}).items()}
    return {"state": _STATE, **own, **others}


def read_end(fields: Mapping[str, Any]) -> dict[tuple[str, str], int] | None:
    """Return the seq after the publisher's last message, by topic and source; None if the event is no end message.

    Args:
        fields: The unchecked fields of a session/event. Entries that do not have the form of `end_data` are ignored.
    """
    data = fields.get("data")
    if fields.get("kind") != "node" or not isinstance(data, Mapping) or data.get("state") != _STATE:
        return None
    sent: dict[tuple[str, str], int] = {}
    for key, count in data.items():
        if type(count) is int and 0 <= count < 2**63 and isinstance(key, str) and key.startswith(_PREFIX):
            topic, _, src = key.removeprefix(_PREFIX).partition(".")
            sent[topic, src or str(fields.get("src"))] = count
    return sent

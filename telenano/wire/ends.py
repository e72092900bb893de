"""The last message of a publisher: how many messages it has sent on each topic, in the data of a session/event.

A reader that has recorded fewer lacks the end of that topic, which no later number would show.
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
        sent: The number of messages sent, by topic, this event included.
        forwarded: The seq after the newest message that was sent on, by topic and source.
    """
    own = {f"{_PREFIX}{topic}": count for topic, count in sent.items()}
    others = {f"{_PREFIX}{topic}.{src}": count for (topic, src), count in (forwarded or {}).items()}
    return {"state": _STATE, **own, **others}


def read_end(fields: Mapping[str, Any]) -> dict[tuple[str, str], int] | None:
    """Return by topic and source the seq after the last one that a publisher has sent; None for any other event.

    Args:
        fields: The fields of a session/event as they came. Entries in another form than that of `end_data` are left
            out.
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

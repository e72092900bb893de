"""Publishing of the last message of a publisher, see proto/ends.py."""

from collections.abc import Mapping
from typing import Any, Protocol

from proto.ends import END_TOPIC, end_data
from proto.messages import Message


class _Numbered(Protocol):
    def publish(self, topic: str, **fields: Any) -> Message:
        """Send a message; the header is filled in."""

    def sequence_numbers(self) -> dict[str, int]:
        """Return the seq of the next message on each topic."""


def publish_end(publisher: _Numbered, node: str, forwarded: Mapping[tuple[str, str], int] | None = None) -> None:
    """Publish how many messages were sent on each topic, as the last of all.

    Args:
        publisher: Sends the event and counts the messages.
        node: The name of the publisher.
        forwarded: The messages that were sent on, see `end_data`.
    """
    sent = publisher.sequence_numbers()
    sent[END_TOPIC] = sent.get(END_TOPIC, 0) + 1
    text = f"{node} has ended, after {sum(sent.values())} messages of its own"
    publisher.publish(END_TOPIC, id="", kind="node", level="info", text=text, data=end_data(sent, forwarded))

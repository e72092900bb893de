"""Who acted in a recording: the names in its commands, answers and events, by what they did."""

from collections import Counter
from collections.abc import Iterator
from typing import Any, Protocol

from telenano.recording.messages import ChannelFilter, LeftOut, RecordedMessage
from telenano.wire.codec import fields_of

TOPICS = ("session/control", "session/event")


class Selectable(Protocol):
    """What messages are selected from: a recording, or its summary."""

    def select(self, wanted: ChannelFilter) -> Iterator[RecordedMessage]:
        """Yield the messages of wanted channels."""


def people_in(recording: Selectable) -> dict[str, dict[str, int]]:
    """Return by name how often it gave each command, and how often it was given the hand.

    A command is sent again until it is answered, and counts once; what cannot be read is left out.
    """
    commands: dict[str, tuple[str, str]] = {}
    hands: Counter[tuple[str, str]] = Counter()
    left_out = LeftOut()

    def take(message: Any) -> None:
        decoded = message.decode()
        fields = fields_of(decoded) if message.channel.topic == "session/control" else decoded.data
        by, command = fields.get("by"), fields.get("command")
        if by and command:
            commands[decoded.id] = by, command
        elif by:
            hands[by, "hand"] += 1

    for message in recording.select(lambda channel: channel.topic in TOPICS and channel.via == "direct"):
        left_out.guard(take, message)
    counted = hands + Counter(commands.values())
    return {name: {what: n for (by, what), n in sorted(counted.items()) if by == name} for name, _ in sorted(counted)}

"""People who acted in a recording, and their actions, from its commands and events."""

from collections import Counter
from collections.abc import Iterator
from typing import Any, Protocol

from telenano.recording.messages import ChannelFilter, LeftOut, RecordedMessage
from telenano.wire.codec import fields_of

TOPICS = ("session/control", "session/event")


class Selectable(Protocol):
    """Source of messages: a recording, or its summary."""

    def select(self, wanted: ChannelFilter) -> Iterator[RecordedMessage]:
        """Yield the messages of the wanted channels."""


def people_in(recording: Selectable) -> dict[str, dict[str, int]]:
    """Return, for each person, the count of each command that they gave, and under `hand` how often they got the hand.

    A command that was repeated until its answer came counts once. Unreadable messages are left out.
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

"""What a recording, and several files of one, have besides messages: fields as arrays, and the scenario."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from telenano.wire.errors import RecordingError

if TYPE_CHECKING:
    from telenano.recording.columns import Column, Source
    from telenano.settings.scenario import Scenario


class RecordedFields:
    """The part of a recording that reads its messages through; what it needs is imported when it is asked for."""

    def columns(self: "Source", channel_topic: str, fields: Sequence[str]) -> "dict[str, Column]":
        """Return fields of every message of a channel as arrays; see `telenano.recording.columns.columns`.

        Example:
            hand = Recording(path).columns("haptic/state", ("t_ns", "position_m.2"))
        """
        from telenano.recording.columns import columns

        return columns(self, channel_topic, fields)

    def column_pieces(self: "Source", channel_topic: str, fields: Sequence[str]) -> "Iterator[dict[str, Column]]":
        """Yield what `columns` returns in pieces of some thousand messages, so that no recording is too long."""
        from telenano.recording.columns import column_pieces

        return column_pieces(self, channel_topic, fields)

    def scenario(self: "Source") -> "Scenario":
        """Return the scenario that is attached; RecordingError where there is none, ConfigError for a wrong key.

        Example:
            period_s = Recording(path).scenario().period_s
        """
        from telenano.settings.config import parse_yaml, validate
        from telenano.settings.scenario import Scenario

        origin = f"{self.path}: scenario.yaml"
        if (content := self.attachments.get("scenario.yaml")) is None:
            raise RecordingError(f"{self.path}: has no scenario attached, so its scales are unknown")
        return validate(Scenario, parse_yaml(content, origin), origin)

"""The exceptions: whatever a user can cause raises one of these; the text names what would be right."""

from typing import Any


class TelenanoError(Exception):
    """Base of every error that the project raises on purpose."""


class ConfigError(TelenanoError):
    """A configuration, scenario or site file is missing or wrong; the text names file and key."""


class EndpointError(TelenanoError):
    """A socket cannot be bound or connected; the text names the endpoint and who holds it, where that is known."""


class RefusedError(TelenanoError):
    """A session/control command was refused by a node; the text goes into the session/event."""


class RecordingError(TelenanoError):
    """A recording cannot be written or read; the text names the file."""


class ReportError(RecordingError):
    """The files of a report cannot be written; `summary` is their content, as plain values."""

    def __init__(self, text: str, summary: dict[str, Any]) -> None:
        super().__init__(text)
        self.summary = summary


class RigError(TelenanoError):
    """The rig could not be started, kept running or reached; the text names the node and its last message."""

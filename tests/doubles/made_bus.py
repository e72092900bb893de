"""What a node asks of its bus and its log where nothing is lost, refused or logged."""

from collections.abc import Sequence
from typing import Any

from telenano.runtime.bus.bus import ConnectionEvent
from telenano.runtime.loop.log import StructuredLog
from telenano.wire.messages import InputHealth


class QuietLog(StructuredLog):
    """Nothing of what the nodes log is of interest."""

    def write(self, level: str, text: str, **facts: Any) -> None:
        """Write nothing."""


class QuietBus:
    """The accounts of a bus to which nothing happens; how it publishes and receives is with each test."""

    def wait(self, deadline_ns: int) -> None:
        """Somebody else lets the time pass."""

    def sequence_numbers(self) -> dict[str, int]:
        return {}

    def input_health(self) -> tuple[InputHealth, ...]:
        return ()

    def rejections(self) -> tuple[dict[str, int], str]:
        return {}, ""

    def process_events(self, *, now: bool = False) -> Sequence[ConnectionEvent]:
        return ()

    def has_arrived(self) -> bool:
        return False

    def close(self) -> None:
        pass

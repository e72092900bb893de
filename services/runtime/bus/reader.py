"""What a bus receives with: a subscriber, an inlet, an end of the link's datagrams; and what looks after it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

from proto.messages import InputHealth
from proto.sequence import SequenceTracker

if TYPE_CHECKING:
    from services.runtime.bus.bus import ConnectionEvent, Received


class Reader(Protocol):
    """What a bus receives with."""

    descriptor: int
    drained: bool
    # It is called in each turn, whether or not its descriptor is readable.
    shared: bool
    # It returns messages at this time without a readable descriptor, on the monotonic clock [ns].
    due_ns: int
    trackers: dict[tuple[str, str], SequenceTracker]
    rejected: dict[str, int]
    last_error: str

    def receive(self, *, signalled: bool = False) -> list["Received"]:
        """Return the messages that have arrived."""

    def input_health(self) -> tuple[InputHealth, ...]:
        """Return the sequence statistics of every input."""


class Refusals(Protocol):
    """What counts the messages or connections that it refuses."""

    @property
    def rejected(self) -> dict[str, int]:
        """How often something was refused, by reason."""

    @property
    def last_error(self) -> str:
        """The newest refusal in words."""


class NetworkEvents(Refusals, Protocol):
    """What looks after the network connections of a bus."""

    has_pending: bool

    @property
    def descriptors(self) -> Sequence[int]:
        """What becomes readable when there is something to process."""

    def process_events(self) -> list["ConnectionEvent"]:
        """Process pending events, a bounded number; `has_pending`: whether more are left."""

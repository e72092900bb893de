"""The interface of a rig in memory to its buses."""

from typing import Any, Protocol

from telenano.timing.clock import Clock, VirtualClock
from telenano.virtual.timing import RandomStreams, Timing
from telenano.wire import Message


class World(Protocol):
    """A rig in memory, as its buses see it.

    Attributes:
        clock: The clock by which the nodes take their turns.
        timing: The delays on the sites.
        streams: The random numbers from which the delays are drawn.
        counts_inputs: Whether node/health contains the inputs of a node.
    """

    clock: VirtualClock
    timing: Timing
    streams: RandomStreams
    counts_inputs: bool

    def clock_of(self, key: str) -> Clock:
        """Return the clock of a node's machine."""

    def endpoint(self, key: str) -> Any:
        """Return the endpoint of a publisher."""

    def carry(self, topic: str, message: Message, payload: bytes, sent_ns: int) -> None:
        """Deliver a message, sent at a time on the clock of the rig [ns], to its subscribers."""

    def forward(self, endpoint: str, topic: str, payload: bytes) -> None:
        """Deliver bytes that left the link at an endpoint to the subscribers there."""

"""What a bus in memory asks of the rig that it belongs to."""

from typing import Any, Protocol

from telenano.timing.clock import Clock, VirtualClock
from telenano.virtual.timing import RandomStreams, Timing
from telenano.wire import Message


class World(Protocol):
    """A rig in memory, as its buses see it.

    Attributes:
        clock: The clock by which the nodes take their turns.
        timing: The delays on the sites.
        streams: The random numbers that the delays are drawn from.
        counts_inputs: Whether node/health has the inputs of a node.
    """

    clock: VirtualClock
    timing: Timing
    streams: RandomStreams
    counts_inputs: bool

    def clock_of(self, key: str) -> Clock:
        """Return the clock of a node, which its machine has."""

    def endpoint(self, key: str) -> Any:
        """Return the endpoint of a publisher."""

    def carry(self, topic: str, message: Message, payload: bytes, sent_ns: int) -> None:
        """Bring a message of its publisher, sent at a time on the clock of the rig [ns], to those who listen."""

    def forward(self, endpoint: str, topic: str, payload: bytes) -> None:
        """Bring bytes that left the link at an endpoint to those who listen there."""

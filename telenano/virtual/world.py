"""What a bus in memory asks of the rig that it belongs to."""

from typing import Any, Protocol

from telenano.timing.clock import VirtualClock
from telenano.virtual.timing import RandomStreams, Timing
from telenano.wire import Message


class World(Protocol):
    """A rig in memory, as its buses see it.

    Attributes:
        clock: The clock of all nodes.
        timing: The delays on the sites.
        streams: The random numbers that the delays are drawn from.
        counts_inputs: Whether node/health has the inputs of a node.
    """

    clock: VirtualClock
    timing: Timing
    streams: RandomStreams
    counts_inputs: bool

    def endpoint(self, key: str) -> Any:
        """Return the endpoint of a publisher."""

    def carry(self, topic: str, message: Message, payload: bytes) -> None:
        """Bring a message of its publisher to those who listen."""

    def forward(self, endpoint: str, topic: str, payload: bytes) -> None:
        """Bring bytes that left the link at an endpoint to those who listen there."""

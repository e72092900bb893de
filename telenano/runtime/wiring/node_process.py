"""The process of a node that a command runs itself, without the launcher.

    with NodeProcess.open("delay_node@master", AddressBook.load(site_file)) as process:
        publisher = process.participant.bind(process.participant.key)
        bus = process.participant.bus_of(publisher, readers)
        process.run(Node(process.participant.context(bus)), bus)

The process gets the scheduling of the nodes, and ends at a stop signal.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Self

from telenano.runtime.bus.address_book import AddressBook
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.node import Node, NodeBus
from telenano.runtime.loop.realtime import RealtimeStatus, apply_realtime
from telenano.runtime.wiring.participant import Participant, StopSignals


@dataclass(frozen=True)
class NodeProcess:
    """The part of this process in the bus, its stop signals and its scheduling."""

    participant: Participant
    signals: StopSignals
    realtime: RealtimeStatus

    @classmethod
    @contextlib.contextmanager
    def open(cls, key: str, book: AddressBook) -> Iterator[Self]:
        """Take part in the bus as a node while the block runs.

        Raises:
            EndpointError: The node is not in the book.
            ConfigError: The node's machine lacks a key that the rig requires.
        """
        signals = StopSignals()
        # The scheduling is set before the ZeroMQ context exists, because the context's threads inherit it.
        realtime = apply_realtime(None, StructuredLog(key), key)
        with Participant.open(key, book, signals.descriptor) as participant:
            yield cls(participant, signals, realtime)

    def run(self, node: Node, bus: NodeBus) -> None:
        """Run a node until it or a signal requests its stop."""
        self.signals.run(node, bus, self.realtime, guarded=True)

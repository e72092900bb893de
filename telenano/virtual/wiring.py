"""Wiring of a process in memory: the builder of a node gets it instead of sockets and keys."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

from telenano.runtime.bus.bus import Bus, Subscriber
from telenano.runtime.bus.handed_reader import HandedReader
from telenano.runtime.loop.node import NodeContext
from telenano.runtime.wiring.link_transports import LinkEnds
from telenano.runtime.wiring.main import Wiring
from telenano.runtime.wiring.participant import SITES, NoNetwork
from telenano.settings.link_files import OWN_TRACES, Traces
from telenano.virtual.bus import RecordingBus, VirtualBus
from telenano.virtual.world import World
from telenano.wire.nodes import site_of


@dataclass(frozen=True, kw_only=True)
class VirtualWiring(Wiring):
    """The wiring of a node in a rig in memory, with the methods that a builder calls.

    `given` is the context of a node that is built beside the running one; None builds the running one.
    """

    rig: World
    given: NodeContext | None = None

    def bind(self, key: str, kind: int = 0, *, ends: bool = False) -> Any:
        return self.rig.endpoint(key)

    def subscribers(
        self,
        connections: Mapping[str, Sequence[str]],
        *,
        apart: bool = False,
        newest_only: bool = False,
        shared: bool = False,
    ) -> list[Subscriber]:
        """Return one reader for the topics of all connections; the bus hands it the messages."""
        topics = {topic for topics in connections.values() for topic in topics}
        return [cast(Subscriber, HandedReader(self.clock, topics, newest_only=newest_only))]

    def observe(
        self, wanted: Callable[[str, str], bool], sites: Sequence[str] = SITES, *, shared: bool = False
    ) -> dict[str, Subscriber]:
        """Return a reader for each node at `sites`, for its topics for which `wanted(topic, node)` is true."""
        topics_of = self.book.observed(self.network.machine, sites)
        plan = {node: [topic for topic in topics if wanted(topic, node)] for node, topics in topics_of.items()}
        return {node: cast(Subscriber, _Observer(self, topics, wanted, node)) for node, topics in plan.items()}

    def bus(self, topics: Sequence[str], *, newest_only: bool = False) -> Any:
        return VirtualBus(self.rig, self.key, topics, newest_only=newest_only)

    def bus_of(self, publisher: Any, subscribers: Sequence[Any]) -> Any:
        publisher.reader = HandedReader(self.clock, {topic for one in subscribers for topic in one.topics})
        return publisher

    def recording_bus(self, make: Callable[..., Any], publisher: Any, listeners: Any, intake: Any) -> Any:
        return RecordingBus(publisher, listeners, intake)

    def traces(self) -> Traces:
        return OWN_TRACES

    def link_ends(self, outgoing: Any, reports: Any, readers: Sequence[Subscriber]) -> LinkEnds:
        return LinkEnds()

    def estop_inlet(self) -> list[Subscriber]:
        return []

    def kept_stop(self) -> None:
        return None

    def context(self, bus: Bus) -> NodeContext:
        return self.given or super().context(bus)


class _Observer(HandedReader):
    """The reader of a recorder for one publisher, also for topics of packages that become known later."""

    def __init__(
        self, wiring: VirtualWiring, topics: Sequence[str], wanted: Callable[[str, str], bool], node: str
    ) -> None:
        super().__init__(wiring.clock, topics)
        self._wanted, self._node = wanted, node

    def wants(self, topic: str) -> bool:
        return super().wants(topic) or self._wanted(topic, self._node)


def network_of(key: str) -> Any:
    """Return the network of node `key` in memory, on the machine of its site."""
    return NoNetwork(site_of(key))

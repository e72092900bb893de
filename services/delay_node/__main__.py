"""Run the link: one process with a publisher at each site."""

import sys

from proto.errors import ConfigError, EndpointError
from services.delay_node.config import LinkSettings
from services.delay_node.node import DelayNode
from services.runtime.bus import ZmqBus
from services.runtime.main import NodeKind, Wiring, run_node
from services.runtime.node import AccountedBus, Node


def build(wiring: Wiring, settings: LinkSettings) -> tuple[Node, AccountedBus]:
    """Bind a publisher at each site and subscribe to the nodes of both."""
    # the publishers first: they are what may fail
    to_master = wiring.publisher("delay_node@master")
    try:
        to_slave = wiring.publisher("delay_node@slave")
    except EndpointError:
        to_master.close()
        raise
    connections = [wiring.book.bridged_from(site) for site in ("master", "slave")]
    for answering, topics in wiring.book.sources("delay_node@slave", ["clock/pong"]).items():
        connections[1].setdefault(answering, []).extend(topics)
    listeners = [listener for plan in connections for listener in wiring.subscribers(plan)]
    bus = ZmqBus(to_master, listeners, wiring.clock, wiring.wake_descriptor, wiring.network)
    bus.also_closes(to_slave)
    try:
        node = DelayNode(wiring.context(bus), settings, to_slave, to_master, wiring.scenario_file.parent)
    except ConfigError as error:
        bus.close()
        raise ConfigError(f"{wiring.scenario_file}: delay_node: {error}") from error
    return node, bus


DELAY_NODE = NodeKind("delay_node", LinkSettings, build)

if __name__ == "__main__":
    sys.exit(run_node(DELAY_NODE))

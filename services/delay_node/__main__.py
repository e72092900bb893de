"""Program of the link: one process with a publisher at each site."""

import gc

if __name__ == "__main__":
    # The imports create no garbage, and searching for it would take an eighth of their time.
    gc.disable()

import sys

from services.delay_node.node import DelayNode
from telenano.runtime.loop.node import Node, NodeBus
from telenano.runtime.loop.realtime import has_fifo
from telenano.runtime.wiring.main import NodeKind, Wiring, run_node
from telenano.settings.link_settings import LinkSettings, changes_text
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import HAND


def build(wiring: Wiring, settings: LinkSettings) -> tuple[Node, NodeBus]:
    """Bind a publisher at each site, subscribe to the nodes of both, and return node and bus.

    Raises:
        ConfigError: The settings of the link cannot be used.
    """
    if changes := changes_text(settings):
        wiring.log.warning(changes)
    # Bind the publishers first, because that may fail.
    to_master, to_slave = (wiring.bind(f"delay_node@{site}") for site in ("master", "slave"))
    # Yield after each message, so that the first message of a burst goes out while the next one is processed. A link
    # without real-time priority does not, because any other process could then get the processor.
    to_master.yields = to_slave.yields = has_fifo()
    connections = [wiring.book.bridged_from(site) for site in ("master", "slave")]
    # The hand's answers do not cross: from them the link knows that it has obeyed a stop.
    if HAND in wiring.book.nodes and wiring.book.reaches(wiring.book.machine_of(wiring.key), HAND):
        connections[0].setdefault(HAND, []).append("session/event")
    for answering, topics in wiring.book.sources("delay_node@slave", ["clock/pong"]).items():
        connections[1].setdefault(answering, []).extend(topics)
    listeners = [listener for plan in connections for listener in wiring.subscribers(plan)]
    ends = wiring.link_ends(to_slave, to_master, listeners)
    bus = wiring.bus_of(to_master, [*listeners, *ends.readers, *wiring.estop_inlet()])
    try:
        folder, apart = wiring.scenario_file.parent, wiring.book.spans_machines
        context, traces = wiring.context(bus), wiring.traces()
        node = DelayNode(
            context, settings, to_slave, to_master, folder,
            spans_machines=apart, send_train=ends.measure, traces=traces,
        )  # fmt: skip
        traces.begin()
    except ConfigError as error:
        raise ConfigError(f"{wiring.scenario_file}: delay_node: {error}") from error
    return node, bus


DELAY_NODE = NodeKind("delay_node", LinkSettings, build)

if __name__ == "__main__":
    sys.exit(run_node(DELAY_NODE))

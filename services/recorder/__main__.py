"""Run the recorder process."""

import gc

if __name__ == "__main__":
    # Imports create no garbage, and the search for it would take an eighth of their time.
    gc.disable()

import sys

from services.recorder.intake import Intake, begin_recording
from services.recorder.node import RecorderBus, RecorderNode
from telenano.console.listener import Listener
from telenano.console.live_recording import connect
from telenano.recording.recorder_config import RecorderConfig, is_bulk
from telenano.runtime.loop.node import Node, NodeBus
from telenano.runtime.wiring.main import NodeKind, Wiring, run_node
from telenano.runtime.wiring.participant import SITES
from telenano.wire import TOPICS
from telenano.wire.ends import END_TOPIC
from telenano.wire.nodes import FAR_RECORDER, site_of


def build(wiring: Wiring, config: RecorderConfig) -> tuple[Node, NodeBus]:
    """Connect to every node of the site file and begin the recording."""
    publisher = wiring.bind(wiring.key)
    intake = begin(wiring, config)
    sources = listeners(wiring, config)
    is_far = wiring.book.spans_machines and site_of(wiring.key) == "slave"
    bus = wiring.recording_bus(RecorderBus, publisher, sources, intake)
    bus.is_brief = is_far
    intake.obeys_link = is_far
    own = (site_of(wiring.key),) if wiring.book.spans_machines else SITES
    return RecorderNode(wiring.context(bus), config, intake, sites=own), bus


def listeners(wiring: Wiring, config: RecorderConfig) -> list[Listener]:
    """Connect to each node for all topics to record; at the slave's site of two machines only to nodes of that site.

    The slave gets the master's messages through the link, and the network must not carry them a second time. If the
    slave's site has a recorder that is fetched later, that one records the fast topics of its machine (ADR 0075), the
    exchanges of time stamps and the reports of the link. Messages that the link carries to the master anyway, such as
    the health of the slave's nodes, are recorded from the link.
    """
    site, book = site_of(wiring.key), wiring.book
    sites = SITES if site == "master" or not book.spans_machines else (site,)
    is_shared = book.spans_machines and config.far == "fetch" and FAR_RECORDER in book.nodes

    def wanted(topic: str, node: str) -> bool:
        is_near = not is_shared or book.machine_of(node) == wiring.network.machine
        # Events are always recorded: they tell where a node's messages ended, and are few. A topic of a package, which
        # may not be in the table yet, does not cross the link.
        is_bridged = topic in TOPICS and TOPICS[topic].bridged == "backward"
        is_brought = site_of(node) != site and is_bridged and topic != END_TOPIC
        is_left = is_bulk(topic) or is_brought or topic.startswith(("clock/", "link/"))
        return config.subscribes(topic, site_of(node)) and (is_near or not is_left)

    inlets = [Listener("estop", inlet) for inlet in wiring.estop_inlet()]
    return [*connect(wiring, sites, wanted, unknown=True), *inlets]


def begin(wiring: Wiring, config: RecorderConfig) -> Intake:
    """Begin the recording; a file that cannot be written is reported as a fault, and the rig continues."""
    facts, disk = wiring.recorded_facts, wiring.machine.disk
    return begin_recording(wiring.key, wiring.clock, config, wiring.site_file, wiring.scenario_file, disk, facts)


RECORDER = NodeKind("recorder", RecorderConfig, build, realtime=False)

if __name__ == "__main__":
    sys.exit(run_node(RECORDER))

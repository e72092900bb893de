"""Run the recorder."""

import sys

from proto import TOPICS
from services.recorder.config import RecorderConfig
from services.recorder.intake import Intake, Listener
from services.recorder.node import RecorderBus, RecorderNode
from services.recorder.provenance import write_provenance
from services.recorder.writer import RecordingWriter
from services.runtime.errors import RecordingError
from services.runtime.main import NodeKind, Wiring, run_node
from services.runtime.node import AccountedBus, Node


def build(wiring: Wiring, config: RecorderConfig) -> tuple[Node, AccountedBus]:
    """Connect to every node of the site file and begin the recording."""
    publisher = wiring.publisher(wiring.key)
    intake = begin(wiring, config)
    bus = RecorderBus(publisher, listeners(wiring), intake, wiring.clock, wiring.wake_descriptor)
    return RecorderNode(wiring.context(bus), config, intake), bus


def listeners(wiring: Wiring) -> list[Listener]:
    """Connect to each node for every recorded topic that can be heard there."""
    found = []
    for node, topics in wiring.book.observed().items():
        recorded = [topic for topic in topics if TOPICS[topic].recorded]
        if recorded:
            found.append(Listener(node, wiring.subscriber({node: recorded})))
    return found


def begin(wiring: Wiring, config: RecorderConfig) -> Intake:
    """Begin the recording; a file that cannot be written is a fault to report, not a reason to stop the rig."""
    try:
        writer = RecordingWriter.create(wiring.key, config)
        write_provenance(writer, config, wiring.site_file, wiring.scenario_file, wiring.clock.now_ns())
    except RecordingError as error:
        return Intake(None, str(error))
    return Intake(writer)


RECORDER = NodeKind("recorder", ("master", "slave"), RecorderConfig, build, realtime=False)

if __name__ == "__main__":
    sys.exit(run_node(RECORDER))

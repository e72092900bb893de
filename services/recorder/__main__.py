"""Run the recorder."""

import sys

from services.recorder.config import RecorderConfig
from services.recorder.intake import Intake, Listener
from services.recorder.live import connect
from services.recorder.node import RecorderBus, RecorderNode
from services.recorder.start import begin_intake
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
    return connect(wiring.zmq_context, wiring.clock, wiring.book)


def begin(wiring: Wiring, config: RecorderConfig) -> Intake:
    """Begin the recording; a file that cannot be written is a fault to report, not a reason to stop the rig."""
    return begin_intake(wiring.key, wiring.clock, config, wiring.site_file, wiring.scenario_file)


RECORDER = NodeKind("recorder", ("master", "slave"), RecorderConfig, build, realtime=False)

if __name__ == "__main__":
    sys.exit(run_node(RECORDER))

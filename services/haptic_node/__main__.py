"""Run the haptic node with its simulated device."""

import sys

from services.haptic_node.config import HapticConfig
from services.haptic_node.node import INPUTS, HapticNode
from services.haptic_node.sim import SimulatedHaptic
from services.runtime.main import NodeKind, ordinary, run_node
from services.runtime.node import NodeContext


def build(context: NodeContext, config: HapticConfig) -> HapticNode:
    """Build the node with its simulated device."""
    return HapticNode(context, config, SimulatedHaptic(config.to_plant_params(), config.device.start_position_m))


HAPTIC_NODE = NodeKind("haptic_node", HapticConfig, ordinary(build, INPUTS))

if __name__ == "__main__":
    sys.exit(run_node(HAPTIC_NODE))

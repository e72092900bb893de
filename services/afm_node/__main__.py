"""Run the AFM node with its simulated instrument."""

import sys

from services.afm_node.config import AfmConfig
from services.afm_node.node import INPUTS, AfmNode
from services.afm_node.sim import SimulatedAfm, SimulatedSpring
from services.runtime.main import NodeKind, ordinary, run_node
from services.runtime.node import NodeContext


def build(context: NodeContext, config: AfmConfig) -> AfmNode:
    """Build the node with its simulated instrument."""
    if config.environment == "spring":
        return AfmNode(context, config, SimulatedSpring(config.to_spring_params()))
    return AfmNode(context, config, SimulatedAfm(config.to_params()))


AFM_NODE = NodeKind("afm_node", AfmConfig, ordinary(build, INPUTS))

if __name__ == "__main__":
    sys.exit(run_node(AFM_NODE))

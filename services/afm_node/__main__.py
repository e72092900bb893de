"""Run the AFM node with the instrument that its configuration names."""

import gc

if __name__ == "__main__":
    # The imports make nothing that could be collected, and to look for it takes an eighth of their time.
    gc.disable()

import sys
from contextlib import nullcontext

from services.afm_node.node import INPUTS, AfmNode
from telenano.devices.afm.instrument import driver_of
from telenano.runtime.loop.node import NodeContext
from telenano.runtime.loop.realtime import ordinary_scheduling
from telenano.runtime.wiring.main import NodeKind, ordinary, run_node
from telenano.sections.afm_section import AfmConfig


def build(context: NodeContext, config: AfmConfig) -> AfmNode:
    """Build the node with its instrument."""
    # Loading and compiling the dynamic model takes seconds, in which the law beside it has to keep its period.
    with ordinary_scheduling() if config.model == "dynamic" else nullcontext():
        return AfmNode(context, config, driver_of(config, context.period_s))


AFM_NODE = NodeKind("afm_node", AfmConfig, ordinary(build, INPUTS))

if __name__ == "__main__":
    sys.exit(run_node(AFM_NODE))

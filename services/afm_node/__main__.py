"""Program of the AFM node, with the instrument that its configuration names."""

import gc

if __name__ == "__main__":
    # The imports create no garbage, and searching for it would take an eighth of their time.
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
    """Return the node with its instrument, which it opens."""
    # Loading and compiling the dynamic model takes seconds, during which the controllers must keep their period.
    with ordinary_scheduling() if config.model == "dynamic" else nullcontext():
        return AfmNode(context, config, driver_of(config, context.period_s))


AFM_NODE = NodeKind("afm_node", AfmConfig, ordinary(build, INPUTS))

if __name__ == "__main__":
    sys.exit(run_node(AFM_NODE))

"""Run one half of the law."""

import gc

if __name__ == "__main__":
    # The imports create no garbage, and the collector would take an eighth of their time.
    gc.disable()

import sys

from services.controller.half import ControllerHalf
from services.controller.master_half import MasterController
from services.controller.slave_half import SlaveController
from telenano.runtime.loop.node import Node, NodeBus, NodeContext
from telenano.runtime.wiring.main import NodeKind, Wiring, run_node
from telenano.sections.controller_section import ControllerConfig
from telenano.wire.nodes import site_of

HALVES: dict[str, type[ControllerHalf]] = {"master": MasterController, "slave": SlaveController}


def half_of_site(context: NodeContext, config: ControllerConfig) -> ControllerHalf:
    """Return the half of the law for the node's site."""
    return HALVES[site_of(context.key)](context, config)


def build(wiring: Wiring, config: ControllerConfig) -> tuple[Node, NodeBus]:
    """Return the half for the node's site and its bus, which delivers only the newest messages of each input."""
    bus = wiring.bus(HALVES[site_of(wiring.key)].inputs, newest_only=True)
    return half_of_site(wiring.context(bus), config), bus


CONTROLLER = NodeKind("controller", ControllerConfig, build)

if __name__ == "__main__":
    sys.exit(run_node(CONTROLLER))

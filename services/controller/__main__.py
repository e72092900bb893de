"""Run one half of the law."""

import sys

from services.controller.config import ControllerConfig
from services.controller.node import MASTER_INPUTS, SLAVE_INPUTS, half_of_site
from services.runtime.loop.main import NodeKind, Wiring, run_node
from services.runtime.loop.node import Node, NodeBus


def build(wiring: Wiring, config: ControllerConfig) -> tuple[Node, NodeBus]:
    """Wire the half that belongs to the site."""
    bus = wiring.bus(MASTER_INPUTS if wiring.key.endswith("@master") else SLAVE_INPUTS, newest_only=True)
    return half_of_site(wiring.context(bus), config), bus


CONTROLLER = NodeKind("controller", ControllerConfig, build)

if __name__ == "__main__":
    sys.exit(run_node(CONTROLLER))

"""The two controller processes: each runs one half of a law on the arrival of messages."""

from proto.nodes import site_of
from services.controller.config import ControllerConfig
from services.controller.half import ControllerHalf
from services.controller.master_half import MasterController
from services.controller.slave_half import SlaveController
from services.runtime.loop.node import NodeContext

HALVES: dict[str, type[ControllerHalf]] = {"master": MasterController, "slave": SlaveController}


def half_of_site(context: NodeContext, config: ControllerConfig) -> ControllerHalf:
    """Return the half of the law that belongs to the node's site."""
    return HALVES[site_of(context.key)](context, config)

"""Program of the node that serves the operator's page."""

import sys
from functools import partial

from telenano.runtime.loop.node import Node, NodeBus
from telenano.runtime.wiring.main import NodeKind, Wiring, run_node
from telenano.serving.config import ViewConfig
from telenano.serving.serve import addresses_of, announced, inherited, missing_for_view
from telenano.wire.errors import ConfigError


def build(wiring: Wiring, config: ViewConfig) -> tuple[Node, NodeBus]:
    """Return the node and its bus, at the address that the launcher has bound, or at an own one, which is announced.

    Raises:
        ConfigError: A dependency of the page is missing, or the settings cannot be used.
    """
    if reason := missing_for_view():
        raise ConfigError(f"the view cannot be served: {reason}")
    from services.viz_node.node import page_of_rig

    tls, access, sockets = config.tls(), config.access(), inherited()
    bound = wiring.resources.enter_context(sockets or config.bind())
    node, bus = page_of_rig(wiring, wiring.site_file, bound, access, tls)
    if sockets is None:
        # Last, after everything that could fail, because a reader may open the address at once.
        addresses = addresses_of(bound, access, tls, config.name)
        wiring.resources.enter_context(announced(addresses, partial(print, flush=True)))
    return node, bus


VIZ_NODE = NodeKind("viz_node", ViewConfig, build, realtime=False, observer=True)

if __name__ == "__main__":
    sys.exit(run_node(VIZ_NODE))

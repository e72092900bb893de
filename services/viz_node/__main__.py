"""Program of the node that serves the operator's page."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from telenano.recording.session_folder import RECORDING_NAME
from telenano.runtime.loop.node import Node, NodeBus
from telenano.runtime.wiring.main import NodeKind, Wiring, run_node
from telenano.serving.config import ViewConfig
from telenano.serving.serve import addresses_of, announced, inherited, missing_for_view
from telenano.settings.scenario import scenario_document
from telenano.wire.errors import ConfigError

if TYPE_CHECKING:
    from services.viz_node.recording_files import RecordingFiles


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
    node, bus = page_of_rig(wiring, wiring.site_file, bound, access, tls, recording_of(wiring.scenario_file))
    if sockets is None:
        # Last, after everything that could fail, because a reader may open the address at once.
        addresses = addresses_of(bound, access, tls, config.name)
        wiring.resources.enter_context(announced(addresses, partial(print, flush=True)))
    return node, bus


def recording_of(scenario_file: Path) -> "RecordingFiles":
    """Return the files that the recorder of a scenario writes; none if the scenario does not name their folder.

    The launcher names the folder of the session in the scenario that it gives to its nodes.
    """
    from services.viz_node.recording_files import RecordingFiles

    section = scenario_document(scenario_file)[0].get("recorder") or {}
    directory = section.get("directory")
    return RecordingFiles.of_recorder(
        None if directory is None else Path(directory), section.get("file_name", RECORDING_NAME)
    )


VIZ_NODE = NodeKind("viz_node", ViewConfig, build, realtime=False, observer=True)

if __name__ == "__main__":
    sys.exit(run_node(VIZ_NODE))

"""The `telenano` command with one process per site: `python benchmarks/site_process/rig.py up --scenario fig12`.

For `loop.py` it replaces the launcher's start of the nodes of a site (`process.py`); recorder, page and launcher are
unchanged. The nodes of a site start, end and restart together.
"""

import subprocess
import sys
from pathlib import Path
from typing import Any

# The script's own folder may be missing from the path if another program starts it.
sys.path.insert(0, str(Path(__file__).parent))

from process import MEMBERS

from telenano.cli.app import main
from telenano.launcher import processes, run

_SCRIPT = Path(__file__).with_name("process.py")
_SITE_OF = {key: site for site, keys in MEMBERS.items() for key in keys}


class SiteProcesses(processes.NodeProcesses):
    """The nodes of a rig as processes, with one process for the nodes of a site."""

    def __init__(self, commands: Any, *given: Any) -> None:
        together = {
            node: [*command[:1], str(_SCRIPT), *command[3:]] if node in _SITE_OF else command
            for node, command in commands.items()
        }
        super().__init__(together, *given)

    def start(self, node: str) -> int:
        for other in MEMBERS.get(_SITE_OF.get(node, ""), ()):
            process: subprocess.Popen[bytes] | None = self._running.get(other)
            if process is not None and process.poll() is None:
                self._running[node] = process
                return process.pid
        return super().start(node)


if __name__ == "__main__":
    run.NodeProcesses = SiteProcesses  # type: ignore[misc]
    sys.argv[0] = "telenano"
    main()

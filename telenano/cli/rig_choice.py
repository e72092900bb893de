"""`--rig NAME` of every command that speaks to a rig. It imports nothing that an emergency stop has no time for."""

import os
import sys

from services.runtime.bus.local_endpoint import RIG_VARIABLE


def choose_rig(name: str | None) -> None:
    """Have this process, and those that it starts, speak to a rig of this name; None leaves it as it is."""
    if name is None:
        return
    from services.runtime.security.private_files import check_rig_name
    from telenano.cli.output import report_errors

    with report_errors("--json" in sys.argv):
        os.environ[RIG_VARIABLE] = check_rig_name(name)

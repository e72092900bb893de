"""`telenano estop`: stop the devices at once. `telenano.cli.estop_command`, which needs no typer, does the work."""

import typer

from telenano.cli.estop_command import EstopRequest, run_estop
from telenano.cli.options import JsonOption, RigFileOption, SiteOption, TargetOption
from telenano.cli.output import print_json


def estop(
    target: TargetOption = "*", site: SiteOption = None, site_file: RigFileOption = None, as_json: JsonOption = False
) -> None:
    """Stop the devices at once, regardless of what else sends commands; exit code 1 unless all have acknowledged.

    Every device of the rig that the target means is asked, from either site, and has a line, or a row of `answers`,
    with its kind: ack, refused, kept (it obeys as soon as it can), absent (it does not run) or unreached (it has not
    answered). A device that has not answered is shown with its last recorded state, which is looked up afterwards.

    Without --rig and --site-file it stops each rig of this user: those of the folder that TELENANO_RUNTIME_DIR names,
    or else those of every folder on this machine. Where there are several, each answer begins with its rig or folder.
    """
    request = EstopRequest(target, site or "", site_file, as_json, answer=print_json)
    raise typer.Exit(run_estop(request))

"""`telenano session`: send a command to the nodes of a running rig."""

import contextlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from telenano.cli.estop_command import EstopRequest, run_estop
from telenano.cli.exit_codes import EXIT_FAILED
from telenano.cli.options import JsonOption, RigFileOption, SiteOption, TargetOption
from telenano.cli.output import print_answer, print_json, report_errors
from telenano.console.command_client import arm_devices, parse_parameters, send_control
from telenano.console.coupling import recouple
from telenano.console.lease import CONSOLE
from telenano.console.lease_register import holding
from telenano.runtime.loop.commands import Command, CommandName
from telenano.settings.included import DEFAULT_SITE_FILE, TWO_SITES_FILE
from telenano.timing.clock import process_start_ns
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import Site

SessionCommand = Literal["arm", "start", "stop", "estop", "set", "mark", "couple"]


def session(
    command: Annotated[SessionCommand, typer.Argument(metavar="COMMAND", help="Command to send.")],
    parameters: Annotated[
        list[str] | None, typer.Argument(metavar="KEY=VALUE", help="Parameters by dotted key, units in the names.")
    ] = None,
    target: TargetOption = "*",
    site: SiteOption = None,
    site_file: RigFileOption = None,
    take: Annotated[bool, typer.Option("--take", help="Take control from a page for this command.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Send a command to a running rig and wait for the answers; exit code 1 if one is refused or missing.

    `set` without --target is for the nodes that have the key; those that do not know it do not count.

    While a person at a page holds control, only stop, estop and mark are taken. TELENANO_NAME names who sends it.
    """
    if command == "estop":
        raise typer.Exit(run_estop(EstopRequest(target, site or "", site_file, as_json)))
    with report_errors(as_json), holding(CONSOLE, role="teacher") if take else contextlib.nullcontext():
        if command == "couple":
            if parameters or target != "*" or site == "slave":
                raise ConfigError("couple takes no parameters and no target, and is given at the master's site")
            text = recouple(site_file or _usual_file(site), issued_ns=process_start_ns())
            print_answer({"command": "couple", "text": text}, text, as_json=as_json)
        else:
            send_command(command, parameters or (), target, site_file, site, as_json=as_json)


def send_command(
    command: CommandName,
    parameters: Sequence[str],
    target: str,
    site_file: Path | None,
    site: Site | None = None,
    *,
    as_json: bool,
) -> None:
    """Send a command, print the answers, and exit with 1 if a node refuses or does not answer."""
    with report_errors(as_json):
        wanted = Command(command, target, parameters=parse_parameters(parameters))
        show = (lambda event: None) if as_json else lambda event: typer.echo(f"{event.src} {event.kind}: {event.text}")
        book_file = site_file or _usual_file(site)
        at, issued_ns = site or "master", process_start_ns()
        if (command, target) == ("arm", "*"):
            answers = arm_devices(book_file, at, show, issued_ns=issued_ns)
        else:
            answers = send_control(wanted, book_file, at, show, issued_ns=issued_ns)
    if as_json:
        rows = {src: {"kind": event.kind, "text": event.text} for src, event in sorted(answers.items())}
        print_json({"command": command, "target": target, "answers": rows})
    refused = [event.text for event in answers.values() if event.kind == "refused"]
    if (command, target) == ("set", "*") and len(refused) < len(answers):
        # Without a target each node is asked, and the key is that of one or a few of them.
        refused = [text for text in refused if not all(_OF_ANOTHER.search(line) for line in text.splitlines())]
    if refused:
        raise typer.Exit(EXIT_FAILED)


# What a node says of a key that it does not have.
_OF_ANOTHER = re.compile("unknown key|cannot be set: settable are")


def _usual_file(site: Site | None) -> Path:
    return DEFAULT_SITE_FILE if site is None else TWO_SITES_FILE

"""`telenano node`: run one node alone."""

import os
import sys
from typing import Annotated

import typer

from proto.errors import ConfigError
from proto.nodes import SERVICES
from telenano.options import command_group
from telenano.output import report_errors

app = command_group()


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []})
def node(
    context: typer.Context,
    name: Annotated[str, typer.Argument(metavar="NAME", help=f"One of {', '.join(SERVICES)}.")],
) -> None:
    """Run one node alone; what follows NAME goes to the node, whose --help lists it."""
    if name == "--help":
        typer.echo(context.get_help())
        return
    with report_errors(as_json=False):
        if name not in SERVICES:
            raise ConfigError(f"unknown node {name!r}: known are {', '.join(SERVICES)}")
    # the node takes the place of this process, so that signals reach it
    os.execv(sys.executable, [sys.executable, "-m", f"services.{name}", *context.args])

"""`telenano node`: run one node alone."""

import sys
from typing import Annotated

import typer

from telenano.cli.completion import service_names
from telenano.cli.options import command_group
from telenano.cli.output import print_answer, report_errors
from telenano.signals import children
from telenano.wire import TOPICS
from telenano.wire.errors import ConfigError, known_names
from telenano.wire.nodes import NODES, SERVICES, module_of, name_of

app = command_group()


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []})
def node(
    context: typer.Context,
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME|list", help=f"One of {', '.join(SERVICES)}; or list.", autocompletion=service_names
        ),
    ],
) -> None:
    """Run one node alone; arguments after NAME go to the node, whose --help lists them. `list` lists the nodes."""
    if name in ("--help", "-h"):
        typer.echo(context.get_help())
        return
    if name == "list":
        _list(as_json="--json" in context.args)
        return
    with report_errors(as_json=False):
        if name not in SERVICES:
            raise ConfigError(f"unknown node {name!r}: {known_names(name, SERVICES)}")
    children.become([sys.executable, "-m", module_of(name), *context.args])


def _list(*, as_json: bool) -> None:
    rows = []
    for row in NODES:
        topics = [name for name, topic in TOPICS.items() if {row.key, name_of(row.key)} & {*topic.publishers}]
        rows.append({"node": row.key, "part": row.part, "required": row.required, "publishes": ", ".join(topics)})
    print_answer({"nodes": rows}, rows, as_json=as_json)

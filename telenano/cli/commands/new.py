"""`telenano new`: a package that extends telenano, ready to install."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, get_args

import typer

from telenano.cli.new_package import Kind, new_package
from telenano.cli.option_rules import Void, rules
from telenano.cli.options import JsonOption
from telenano.cli.output import print_json, report_errors
from telenano.wire.errors import ConfigError
from telenano.wire.printable import quoted


@rules(Void("--node", "the only kind that has a node", unless="KIND device"))
def new(
    kind: Annotated[Kind, typer.Argument(metavar="KIND", help=f"One of {', '.join(get_args(Kind))}.")],
    name: Annotated[str, typer.Argument(metavar="NAME", help="Its name in a scenario, such as my_law.")],
    out: Annotated[
        Path | None, typer.Option("--out", "-o", metavar="DIR", help="Folder to make; default: telenano-NAME.")
    ] = None,
    node: Annotated[
        str | None,
        typer.Option(
            "--node",
            metavar="NODE",
            help="Node of a device; afm_node is the same as `instrument`; default: haptic_node.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Make a package with one of these of yours, a test of it and all that pip needs."""
    with report_errors(as_json):
        if node not in (None, "haptic_node", "afm_node"):
            raise ConfigError(f"--node {node}: devices are those of haptic_node and of afm_node")
        if kind == "device" and node == "afm_node":
            kind = "instrument"
        folder = out or Path(f"telenano-{name.replace('_', '-')}")
        written = new_package(kind, name, folder)
    if as_json:
        print_json({"folder": str(folder), "files": [str(path) for path in written]})
        return
    for path in written:
        typer.echo(path)
    # If the backend is installed already, as in a checkout, pip need not fetch it into an isolated environment.
    ready = all(find_spec(name) is not None for name in ("hatchling", "editables"))
    option = "--no-build-isolation " if ready else ""
    given = quoted(folder)
    typer.echo(f"next: pip install {option}-e {given} && pytest {given}")

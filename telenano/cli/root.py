"""The root of all commands. Each one is a module of `telenano.cli.commands`, imported when it runs."""

from importlib.metadata import version
from typing import Annotated

import typer

from telenano.cli.lazy_commands import LazyRoot

app = typer.Typer(
    cls=LazyRoot,
    help="A software rig for remote touch at the nanoscale: hand, delayed network, atomic force microscope.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    # markup would swallow the units in brackets
    rich_markup_mode=None,
)


@app.callback(invoke_without_command=True)
def root(
    show_version: Annotated[bool, typer.Option("--version", help="Print the version and exit.", is_eager=True)] = False,
) -> None:
    """Run a rig, inspect its bus, read its recordings."""
    if show_version:
        typer.echo(version("telenano"))
        raise typer.Exit

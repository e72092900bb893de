"""The root of all commands; each command is a module of `telenano.cli.commands`, imported when it runs."""

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
    # Markup would swallow the units in brackets.
    rich_markup_mode=None,
)


def _whole_help(ctx: typer.Context, asked: bool) -> None:
    if asked:
        ctx.command.lists_all = True  # type: ignore[attr-defined]
        typer.echo(ctx.get_help())
        raise typer.Exit


@app.callback(invoke_without_command=True)
def root(
    show_version: Annotated[
        bool, typer.Option("--version", "-V", help="Print versions and exit.", is_eager=True)
    ] = False,
    help_all: Annotated[
        bool, typer.Option("--help-all", help="List every command and exit.", is_eager=True, callback=_whole_help)
    ] = False,
) -> None:
    """Run a rig, inspect its bus, read its recordings."""
    if show_version:
        from telenano.settings.plugins import all_installed

        packages = sorted({f"{row.package} {row.version}" for row in all_installed()})
        typer.echo("\n".join([version("telenano"), *packages]))
        raise typer.Exit

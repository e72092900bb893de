"""Commands that are imported when they run: the help of `telenano` is there at once, without what they need."""

import importlib
from typing import Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup


class LazyCommand(NamedTuple):
    """Where a command is, and what the list of commands says of it."""

    module: str
    attribute: str
    about: str


LAZY_COMMANDS = {
    "bag": LazyCommand(
        "telenano.commands.bag",
        "app",
        "Look into a recording, and make others from it.",
    ),
    "keys": LazyCommand(
        "telenano.commands.keys",
        "app",
        "Make, show and list the keys with which machines prove themselves.",
    ),
    "record": LazyCommand(
        "telenano.commands.record",
        "record",
        "Attach to a running rig and record it.",
    ),
    "doctor": LazyCommand(
        "telenano.doctor.report",
        "doctor",
        "Look whether this machine can run a rig, and say what to do.",
    ),
    "replay": LazyCommand(
        "telenano.commands.replay",
        "replay",
        "Play a recording in the place of nodes that do not run.",
    ),
    "status": LazyCommand(
        "telenano.commands.status",
        "status",
        "Say how a running rig is doing.",
    ),
    "study": LazyCommand(
        "telenano.commands.study",
        "app",
        "Studies in lockstep: which delay each law bears, and what the hand feels of it.",
    ),
}


def load(name: str) -> Any:
    """Import one of the late commands."""
    found = getattr(importlib.import_module(LAZY_COMMANDS[name].module), LAZY_COMMANDS[name].attribute)
    if isinstance(found, typer.Typer):
        return typer.main.get_command(found)
    alone = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    alone.command(name)(found)
    return typer.main.get_command(alone)


class LazyRoot(TyperGroup):
    """The group of all commands, which lists the late ones without importing them."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Give the names of all commands."""
        return [*super().list_commands(ctx), *LAZY_COMMANDS]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Give a command; of a late one what the list needs."""
        if cmd_name in LAZY_COMMANDS:
            return TyperCommand(name=cmd_name, help=LAZY_COMMANDS[cmd_name].about)
        return super().get_command(ctx, cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Give the command to run, imported now if it is a late one."""
        if args and args[0] in LAZY_COMMANDS:
            return args[0], load(args[0]), args[1:]
        return super().resolve_command(ctx, args)

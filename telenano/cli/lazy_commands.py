"""The table of commands, each imported when it runs: `telenano --help` answers at once, without what they need."""

import contextlib
import gc
import importlib
import sys
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

from proto.errors import probably_meant
from services.runtime.bus.local_endpoint import FIRST_RIG, RIG_VARIABLE
from services.signals import interrupts
from telenano.cli.rig_choice import choose_rig

# typer has no other name for the base of all errors of the command line.
_UsageError: Any = typer.BadParameter.__base__


# A missing module of these is a fault of the installation, not a missing extra.
_OWN = ("proto", "presets", "recording", "services", "analysis", "studies", "telenano")


class LazyCommand(NamedTuple):
    """Where a command or a group of them is defined, and its line in the list of commands."""

    module: str
    attribute: str
    about: str


LAZY_COMMANDS = {
    "up": LazyCommand(
        "telenano.cli.commands.up", "up", "Run a scenario on a rig, record it, write figure and summary."
    ),
    "session": LazyCommand("telenano.cli.commands.session", "session", "Send a command to a running rig."),
    "estop": LazyCommand(
        "telenano.cli.commands.estop", "estop", "Stop the devices at once, whoever else sends commands."
    ),
    "status": LazyCommand("telenano.cli.commands.status", "status", "Show the state of a running rig."),
    "view": LazyCommand("telenano.cli.commands.view", "view", "Open the operator's page of a rig or of a recording."),
    "bridge": LazyCommand("telenano.cli.commands.bridge", "app", "Hand a running rig to the viewers of others."),
    "topic": LazyCommand("telenano.cli.commands.topic", "app", "Inspect the messages of a running rig."),
    "link": LazyCommand("telenano.cli.commands.link", "app", "Show and change the link of a running rig."),
    "node": LazyCommand("telenano.cli.commands.node", "app", "Run one node alone."),
    "record": LazyCommand("telenano.cli.commands.record", "record", "Attach to a running rig and record it."),
    "replay": LazyCommand(
        "telenano.cli.commands.replay", "replay", "Play a recording in the place of nodes that do not run."
    ),
    "report": LazyCommand("telenano.cli.commands.report", "report", "Write figure and summary of a recording again."),
    "compare": LazyCommand(
        "telenano.cli.commands.compare", "compare", "Draw sessions over one another, with one table."
    ),
    "bag": LazyCommand("telenano.cli.commands.bag", "app", "Inspect a recording, and make others from it."),
    "study": LazyCommand(
        "telenano.cli.commands.study",
        "app",
        "Study each law in lockstep: stability, transparency.",
    ),
    "experiment": LazyCommand(
        "telenano.cli.commands.experiment", "app", "Run trials of people or simulated operators over conditions."
    ),
    "benchmark": LazyCommand(
        "telenano.cli.commands.benchmark", "benchmark", "Run the benchmark of laws: which law for which network."
    ),
    "scenario": LazyCommand("telenano.cli.commands.scenario", "app", "List, show, check and make scenarios."),
    "param": LazyCommand("telenano.cli.commands.param", "app", "List the keys of a scenario, and get their values."),
    "graph": LazyCommand("telenano.cli.commands.graph", "graph", "Draw the nodes, and the topics between them."),
    "law": LazyCommand("telenano.cli.commands.law", "app", "List, show and check laws, those of packages included."),
    "new": LazyCommand("telenano.cli.commands.new", "new", "Make a package with a law, device, sample or program."),
    "sample": LazyCommand(
        "telenano.cli.commands.sample", "app", "Make or read a surface as a round tip sees it; import recorded maps."
    ),
    "scan": LazyCommand(
        "telenano.cli.commands.scan", "scan", "Image a sample: tapping or contact mode, simulated time."
    ),
    "curve": LazyCommand(
        "telenano.cli.commands.curve",
        "curve",
        "Measure a force curve of the simulated instrument, beside a measured one.",
    ),
    "particles": LazyCommand(
        "telenano.cli.commands.assemble", "particles", "Find spheres in an image: places, radii and their errors."
    ),
    "assemble": LazyCommand(
        "telenano.cli.commands.assemble", "assemble", "Push particles into a pattern, in simulated time."
    ),
    "push": LazyCommand("telenano.cli.commands.push", "push", "Push one particle, in simulated time or on a rig."),
    "calibrate": LazyCommand(
        "telenano.cli.commands.calibrate", "app", "Calibrate read-out and stiffness: simulated, or of own measurements."
    ),
    "reproduce": LazyCommand(
        "telenano.cli.commands.reproduce", "reproduce", "Make figures and equations of the paper again, on one page."
    ),
    "keys": LazyCommand("telenano.cli.commands.keys", "app", "Make, show and list the keys that identify machines."),
    "relay": LazyCommand(
        "telenano.cli.commands.relay", "relay", "Run a relay between two sites that can only dial out."
    ),
    "device": LazyCommand("telenano.cli.commands.device", "app", "List, probe and watch real devices; emulate some."),
    "doctor": LazyCommand("telenano.doctor.report", "doctor", "Check whether this machine can run a rig."),
}


GROUPS = {
    "Run": ("up", "session", "estop", "replay", "node"),
    "Look": ("status", "view", "topic", "link", "graph", "bridge"),
    "Record and report": ("record", "bag", "report", "compare"),
    "Study": (
        "experiment",
        "study",
        "benchmark",
        "law",
        "curve",
        "scan",
        "sample",
        "particles",
        "push",
        "assemble",
        "calibrate",
        "reproduce",
    ),
    "Set up": ("scenario", "param", "new", "device", "keys", "relay", "doctor"),
}


def load(name: str) -> Any:
    """Import a command of the table."""
    row = LAZY_COMMANDS[name]
    # What an import makes stays: looking through it for garbage, again and again, takes a sixth of its time.
    collects = gc.isenabled()
    gc.disable()
    try:
        found = getattr(importlib.import_module(row.module), row.attribute)
    finally:
        if collects:
            gc.enable()
    if isinstance(found, typer.Typer):
        command = typer.main.get_command(found)
        command.help = command.help or row.about
        return _plain(command)
    alone = typer.Typer(
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    alone.command(name)(found)
    return _plain(typer.main.get_command(alone))


def _plain(command: Any) -> Any:
    """Name arguments and bounded numbers by their metavars alone, and list commands with their whole sentences."""
    for parameter in command.params:
        if parameter.metavar is None and getattr(parameter, "min", None) is not None:
            parameter.metavar = "N"
    if any(parameter.name == "site_file" for parameter in command.params):
        # What names the address book of a rig names the rig.
        command.params.append(_rig_option())
    for child in getattr(command, "commands", {}).values():
        # The help is the whole sentence, which would be cut off after 45 letters.
        child.short_help = child.short_help or " ".join((child.help or "").partition("\n\n")[0].split())
        _plain(child)
    return command


def _rig_option() -> Any:
    """Return `--rig`, which chooses the rig and is no argument of a command; typer makes it of a signature alone."""
    option = typer.Option(
        "--rig",
        metavar="NAME",
        help=f"Rig of several on this machine; default: {RIG_VARIABLE}, else the first one, {FIRST_RIG}.",
        expose_value=False,
        is_eager=True,
        callback=choose_rig,
    )
    alone = typer.Typer(add_completion=False)

    @alone.command()
    def named(rig: Annotated[str | None, option] = None) -> None: ...

    return next(parameter for parameter in typer.main.get_command(alone).params if parameter.name == "rig")


class LazyRoot(TyperGroup):
    """The group of all commands, which lists them without importing them, and reports what none of them did."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        windows_expand_args: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command and exit; a usage error, and what the system refuses, is a sentence as any other error is."""
        as_json = "--json" in (sys.argv[1:] if args is None else args)
        try:
            code = super().main(args, prog_name, complete_var, False, windows_expand_args, **extra)
        except (_UsageError, OSError, ModuleNotFoundError, typer.Abort) as error:
            if not standalone_mode or interrupts.received():
                raise
            code = _report(error, as_json=as_json)
        if not standalone_mode:
            return code
        sys.exit(code if isinstance(code, int) else 0)

    def make_context(self, *args: Any, **extra: Any) -> Any:
        with _unknown_to_typer():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        with _unknown_to_typer():
            return super().invoke(ctx)

    def list_commands(self, ctx: Any) -> list[str]:
        return list(LAZY_COMMANDS)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands under the headings of GROUPS, each with its whole line."""
        for heading, names in GROUPS.items():
            with formatter.section(heading):
                formatter.write_dl([(name, LAZY_COMMANDS[name].about) for name in names])

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return what the list of commands needs of one; None if it is unknown."""
        row = LAZY_COMMANDS.get(cmd_name)
        return None if row is None else TyperCommand(name=cmd_name, help=row.about)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command to run, imported now; an unknown name is a usage error."""
        if args and args[0] in LAZY_COMMANDS:
            return args[0], load(args[0]), args[1:]
        if args and not args[0].startswith("-"):
            ctx.fail(f"no such command {args[0]!r}{probably_meant(args[0], LAZY_COMMANDS)}")
        return super().resolve_command(ctx, args)


@contextlib.contextmanager
def _unknown_to_typer() -> Iterator[None]:
    """Raise an interruption on as what typer does not catch: it would end the command without a word."""
    try:
        yield
    except KeyboardInterrupt as error:
        raise interrupts.Ended from error


def _report(error: Any, *, as_json: bool) -> int:
    """Print what no command has reported; return the exit code."""
    from proto.extras import missing
    from telenano.cli.exit_codes import EXIT_BAD_CONFIGURATION, EXIT_FAILED
    from telenano.cli.output import print_error, system_error_text, usage_text

    if isinstance(error, ModuleNotFoundError):
        package = (error.name or "").partition(".")[0]
        if not package or package in _OWN:
            raise error
        print_error(missing(package), as_json=as_json)
        return EXIT_BAD_CONFIGURATION
    if isinstance(error, typer.Abort):
        print_error("the input ended before the question was answered", as_json=as_json)
        return EXIT_FAILED
    if isinstance(error, OSError):
        print_error(system_error_text(error), as_json=as_json)
        return EXIT_FAILED
    code: int = error.exit_code
    if error.format_message().startswith("Usage:"):
        # A group without a command shows its help.
        error.show()
    else:
        print_error(usage_text(error), as_json=as_json)
    return code

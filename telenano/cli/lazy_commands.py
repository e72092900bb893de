"""The table of commands, each imported when it runs, so that `telenano --help` answers at once."""

import contextlib
import gc
import importlib
import os
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

from telenano.cli.option_rules import check_options
from telenano.runtime.bus.local_endpoint import FIRST_RIG, RIG_VARIABLE
from telenano.settings import plugins
from telenano.settings.known_packages import KNOWN_PACKAGES, OWN_PACKAGES
from telenano.signals import interrupts
from telenano.wire.errors import ConfigError, TelenanoError, named_by, probably_meant
from telenano.wire.nodes import module_of

# The packages that the wheel installs at the top level.
_OWN = ("services", "telenano")
# typer does not export the base of its usage errors.
_UsageError: Any = typer.BadParameter.__base__


class LazyCommand(NamedTuple):
    """A command or a group: its module and attribute, its line in the list, and the entry of its package, if any."""

    module: str
    attribute: str
    about: str
    entry: plugins.Plugin | None = None


# The commands of telenano itself, each in the module of its name; a group is the `app` of its module.
_ABOUT = {
    "up": "Run a scenario on a rig, record it, write figure and summary.",
    "simulate": "Run a scenario in virtual time, record it, write figure and summary.",
    "session": "Send a command to a running rig.",
    "estop": "Stop the devices at once, regardless of what else sends commands.",
    "status": "Show the state of a running rig.",
    "view": "Open the operator's page of a rig or of a recording.",
    "bridge": "Publish a running rig to other viewers.",
    "topic": "Inspect the messages of a running rig.",
    "link": "Show and change the link of a running rig.",
    "node": "Run one node alone.",
    "record": "Attach to a running rig and record it.",
    "replay": "Play a recording instead of nodes that do not run.",
    "report": "Write figure and summary of a recording again.",
    "bag": "Inspect a recording, and make others from it.",
    "scenario": "List, show, check and make scenarios.",
    "param": "List the keys of a scenario, and get their values.",
    "law": "List, show and check laws, those of packages included.",
    "new": "Make a package with a law, device, sample or program.",
    "keys": "Make, show and list the keys that identify machines.",
    "device": "List, probe and watch real devices; emulate some.",
    "doctor": "Check whether this machine can run a rig.",
}
_GROUPS = ("bridge", "topic", "link", "node", "bag", "scenario", "param", "law", "keys", "device")
_MODULES = {name: f"telenano.cli.commands.{name}" for name in _ABOUT}
# A command that starts a process of the rig is defined in the folder of that process.
_PROCESSES = (("record", "recorder"), ("replay", "player"), ("view", "viz_node"))
_MODULES |= {name: f"{module_of(process)}.command" for name, process in _PROCESSES}
LAZY_COMMANDS = {
    name: LazyCommand(_MODULES[name], "app" if name in _GROUPS else name, about) for name, about in _ABOUT.items()
}


# Commands of the test kit, with which laws of packages and clients of the protocol are examined.
_TEST_KIT = {
    ("conformance",): LazyCommand(
        "telenano.testing.conformance.conformance_command",
        "conformance",
        "Check a client in any language against the rules of the protocol.",
    ),
    ("law", "balance"): LazyCommand(
        "telenano.testing.law_balance.balance_command",
        "law_balance",
        "Run random sequences of events against a law, and report the energy that it generates at its ports.",
    ),
}

# The order of the list of commands; it includes the commands of this project's packages, which appear if installed.
GROUPS = {
    "Run": ("up", "simulate", "session", "estop", "replay", "node"),
    "Look": ("status", "view", "topic", "link", "bridge", "inspect"),
    "Record and report": ("record", "bag", "report", "budget", "compare"),
    "Study": ("experiment", "study", "benchmark", "law", "curve", "scan", "sample", "particles", "push", "assemble",
              "calibrate", "reproduce"),
    "Set up": ("scenario", "param", "new", "device", "keys", "relay", "gateway", "doctor", "conformance"),
}  # fmt: skip
# `--help` lists these, which are enough to begin with, and `--help-all` lists every command.
FIRST_COMMANDS = ("up", "simulate", "session", "estop", "replay", "status", "view", "link", "bag", "experiment",
                  "study", "scan", "curve", "scenario", "new", "device", "doctor")  # fmt: skip
# The help of `up` begins with these options.
FIRST_OPTIONS = ("scenario", "round_trip_ms", "settings", "duration_s", "sweep", "out", "overwrite", "headless",
                 "no_view", "quiet", "as_json")  # fmt: skip


@cache
def package_commands() -> dict[tuple[str, ...], LazyCommand]:
    """Return the commands of installed packages and of the test kit by their words, without importing their modules.

    The entry of a package is a dictionary such as `{"bridge mine": ("my_package.command:mine", "One sentence.")}`.
    """
    commands = dict(_TEST_KIT)

    def checked(name: str, rows: Any) -> Any:
        new, entry = {}, plugins.installed("commands")[name]
        for words, (target, about) in rows.items():
            path, (module, _, attribute) = tuple(words.split()), target.partition(":")
            if not path or not attribute:
                raise ValueError(f"{words!r}: {target!r} is not words and module:function")
            if not (isinstance(about, str) and about.strip()):
                raise ValueError(f"{words!r}: {about!r} is not a sentence that says what the command does")
            if path in commands or (path[0] in LAZY_COMMANDS and len(path) == 1):
                raise ValueError(f"there is a command {words!r} already")
            new[path] = LazyCommand(module, attribute, about, entry)
        commands.update(new)
        return rows

    plugins.load("commands", checked)
    return commands


def load(name: str) -> Any:
    """Import a command of the table, or one of a package."""
    return load_row(name, LAZY_COMMANDS.get(name) or package_commands()[(name,)], (name,))


def function_of_package(words: str) -> Any:
    """Return the function of a command that a package of the project has; ConfigError where it is not installed."""
    from telenano.wire.extras import how_to_add_package

    row = package_commands().get(tuple(words.split()))
    if row is None:
        package = KNOWN_PACKAGES[f"command {words}"]
        raise ConfigError(f"the command {words!r} is in the package {package}: {how_to_add_package(package)}")
    return getattr(importlib.import_module(row.module), row.attribute)


def load_row(name: str, row: LazyCommand, path: tuple[str, ...]) -> Any:
    """Import the command of a row; a group also gets the commands that packages add to it.

    Raises:
        ConfigError: The row of a package does not lead to a command.
    """
    try:
        return _made(name, getattr(importlib.import_module(row.module), row.attribute), row.about, path)
    except BaseException as error:
        entry, top = row.entry, row.module.partition(".")[0]
        # If a package of this project lacks a library, another sentence says how to install that.
        is_library = isinstance(error, ModuleNotFoundError) and (error.name or top).partition(".")[0] != top
        if entry is None or (is_library and entry.package in OWN_PACKAGES):
            raise
        text = f"{plugins.fault_of_import(error)}; {row.module}:{row.attribute} must be a function or a group of typer"
        command = f"the command {' '.join(path)!r} of the package {entry.package} {entry.version}"
        raise ConfigError(f"{command} cannot be used: {text} that can be imported") from error
    finally:
        # The imports are done, and the command may run for long.
        gc.enable()


def _made(name: str, found: Any, about: str, path: tuple[str, ...]) -> Any:
    if isinstance(found, typer.Typer):
        command: Any = typer.main.get_command(found)
        command.help = command.help or about
        return _plain(command, path)
    alone = typer.Typer(
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    alone.command(name, cls=_UpCommand if name == "up" else TyperCommand)(found)
    return _plain(typer.main.get_command(alone), path)


class _UpCommand(TyperCommand):
    """The command with the most options: its help begins with those that people need first."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        rows = {one.name: row for one in self.get_params(ctx) if (row := one.get_help_record(ctx))}
        arguments = [rows.pop(one.name) for one in self.get_params(ctx) if one.param_type_name == "argument"]
        first = [rows.pop(name) for name in FIRST_OPTIONS]
        for heading, listed in (("Arguments", arguments), ("Options", first), ("More options", list(rows.values()))):
            with formatter.section(heading):
                formatter.write_dl(listed)


def _plain(command: Any, path: tuple[str, ...]) -> Any:
    """Show arguments and bounded numbers by their metavars alone, and list commands with their whole sentences."""
    for parameter in command.params:
        if parameter.metavar is None and getattr(parameter, "min", None) is not None:
            parameter.metavar = "N"
    check_options(command)
    if any(parameter.name == "site_file" for parameter in command.params):
        # A command that takes the address book of a rig takes the name of a rig as well.
        command.params.append(_rig_option())
    if isinstance(command, OpenGroup):
        command.path = path
    for name, child in getattr(command, "commands", {}).items():
        # Without a short help the list would cut the sentence off after 45 letters.
        child.short_help = child.short_help or " ".join((child.help or "").partition("\n\n")[0].split())
        _plain(child, (*path, name))
    return command


# Key of the rig that `--rig` names, in the facts of an invocation.
NAMED_RIG = "telenano.rig"


def _choose_rig(context: typer.Context, name: str | None) -> None:
    """Make this process and its children use the rig of this name; None changes nothing."""
    if name is None:
        return
    context.meta[NAMED_RIG] = name
    # An emergency stop has no time for these imports.
    from telenano.cli.output import report_errors
    from telenano.runtime.security.private_files import check_rig_name

    with report_errors("--json" in sys.argv):
        os.environ[RIG_VARIABLE] = check_rig_name(name)


def _rig_option() -> Any:
    """Return the option `--rig`, which selects the rig and is not passed to the command.

    typer makes an option only from the signature of a function.
    """
    option = typer.Option(
        "--rig",
        metavar="NAME",
        help=f"Rig of several on this machine; default: {RIG_VARIABLE}, else the first one, {FIRST_RIG}.",
        expose_value=False,
        is_eager=True,
        callback=_choose_rig,
    )
    alone = typer.Typer(add_completion=False)

    @alone.command()
    def named(rig: Annotated[str | None, option] = None) -> None: ...

    return next(parameter for parameter in typer.main.get_command(alone).params if parameter.name == "rig")


# The most commands or options that an error names for a word.
_MOST_MEANT = 4
# Commands by another name.
ALIASES = {"run": "up"}
# Hints for words that people type for something that has another name.
_ENDS = (
    "Ctrl-C ends a session in its terminal, `telenano session stop` stops the hand of a running rig, and"
    " `telenano estop` its devices at once"
)
_STATES = "`telenano status` shows the nodes of a running rig, and `telenano status --all` the rigs of this machine"
_MAKES = "`telenano new KIND NAME` makes a package to fill in, and `telenano scenario new NAME` an experiment"
_KEYS = "`telenano param list` has the keys of an experiment, and `telenano scenario show fig12` those of one"
_AGES = "`telenano link show` says how long the link of a running rig takes, and `telenano status` how old inputs are"
_PAGE = "`telenano view` serves the operator's page"
MEANT = {
    **dict.fromkeys(("stop", "down", "kill", "shutdown", "quit", "disarm"), _ENDS),
    **dict.fromkeys(("ps", "top", "monitor", "health", "stats"), _STATES),
    **dict.fromkeys(("init", "create"), _MAKES),
    **dict.fromkeys(("config", "settings", "params"), _KEYS),
    **dict.fromkeys(("ping", "latency", "delay"), _AGES),
    **dict.fromkeys(("gui", "web", "ui", "page"), _PAGE),
    "ls": "`telenano bag list` has the recordings of this folder, and `telenano scenario list` the experiments",
    **dict.fromkeys(("log", "logs"), "each node of a session writes its log to the folder `logs` beside its recording"),
    "test": "`telenano doctor` tests this machine, and `telenano device trial` a device",
    **dict.fromkeys(("head", "dump"), "`telenano bag cat FILE` prints the messages of a recording"),
    "import": "`telenano sample import` reads a surface, and `telenano inspect FILE` says what is in a file",
    **dict.fromkeys(
        ("arm", "couple", "mark"),
        "`telenano session --help` has the commands for a running rig, such as `telenano session arm`",
    ),
    "emergency-stop": "`telenano estop` stops the devices of a running rig at once",
    "start": "`telenano up fig12` starts a rig, and `telenano session start` the hand of a running one",
    "demo": "`telenano up fig12` runs the session of Fig. 12, and `telenano view --demo` shows a recorded one",
    "list": "`telenano scenario list` has the scenarios, `telenano law list` the laws, `telenano status --all` the"
    " rigs",
    "laws": "`telenano law list` has the laws, and `telenano law show LAW` the parameters of one",
    "scenarios": "`telenano scenario list` has the scenarios, and `telenano scenario show NAME` the keys of one",
    "restart": "a node that ends is started again by `telenano up` itself; after Ctrl-C the same `telenano up` begins a"
    " new session",
    "open": "`telenano view FILE` shows a recording",
    "plot": "`telenano report FILE --out DIR` draws the figure of a recording",
    "play": "`telenano view FILE` shows a recording, and `telenano replay FILE` sends it into a rig",
}


class OpenGroup(TyperGroup):
    """A group whose commands, besides those of its own module, are imported when they run; packages can add some."""

    path: tuple[str, ...] = ()
    own_rows: Mapping[str, LazyCommand] = {}

    def rows(self) -> Mapping[str, LazyCommand]:
        """Return the commands that are imported when they run, including those of packages."""
        added = {path[-1]: row for path, row in package_commands().items() if path[:-1] == self.path}
        return {**added, **self.own_rows}

    def list_commands(self, ctx: Any) -> list[str]:
        return list(dict.fromkeys([*super().list_commands(ctx), *self.own_rows, *self.rows()]))

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command with the help that the list of commands needs; None if it is unknown."""
        row = None if cmd_name in self.commands else self.rows().get(cmd_name)
        if row is None:
            return super().get_command(ctx, cmd_name)
        return TyperCommand(name=cmd_name, help=row.about, short_help=row.about)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command to run, imported now; an unknown name is a usage error, which names a known package."""
        name = args[0] if args else ""
        if not name or name.startswith("-") or name in self.commands:
            return super().resolve_command(ctx, args)
        if name == "help" and self.path:
            typer.echo(ctx.get_help())
            raise typer.Exit
        path = (*self.path, name)
        if row := self.own_rows.get(name) or self.rows().get(name):
            return name, load_row(name, row, path), args[1:]
        # The missing command may be in another package than its group, which is missing as well.
        asked = (" ".join([*path, *args[1:2]]), " ".join(path))
        if words := [each for each in asked if f"command {each}" in KNOWN_PACKAGES]:
            from telenano.wire.extras import how_to_add_package

            package, last = KNOWN_PACKAGES[f"command {words[0]}"], words[0].removeprefix(" ".join([*self.path, ""]))
            ctx.fail(f"the command {last!r} is in the package {package}: {how_to_add_package(package)}")
        near = probably_meant(name, self.list_commands(ctx))
        # A variant of the name, such as its plural, is preferred to commands whose text only contains the word.
        if name in MEANT or not any(near == f"; did you mean {each}?" for each in (name[:-1], f"{name}s")):
            near = self._meant(ctx, name) or near
        if not near:
            near = f"; there are {', '.join(self._first(ctx))}"
        return ctx.fail("; ".join([f"no such command {name!r}{near}", *plugins.known_problems()]))

    def _first(self, ctx: Any) -> list[str]:
        """Return the commands for a beginner; in a group, all of them."""
        return [name for name in self.list_commands(ctx) if self.path or name in FIRST_COMMANDS]

    def _meant(self, ctx: Any, name: str) -> str:
        """Return `: …` with what an unknown command may stand for: a file, a scenario, an option, or other commands."""
        if os.path.exists(name):  # noqa: PTH110 - `Path.exists` raises for a name that is too long
            from telenano.wire.printable import quoted

            if not name.endswith((".yaml", ".yml")):
                shown = quoted(name)
                return (
                    f": it is a file or a folder; `telenano view {shown}` shows a recording, `telenano bag info"
                    f" {shown}` says what is in one, and `telenano inspect {shown}` what is in another file"
                )
            return f": it is a file; `telenano up {quoted(name)}` runs it"
        if not self.path:
            from telenano.settings.included import known_scenarios

            if name in known_scenarios():
                return f": it is a scenario; `telenano up {name}` runs it"
        root = ctx.find_root().command
        groups = {row: root.command_at(row) for row in (*_GROUPS, "session")}
        # A command of a group, or one of the root, may have this name, or its sentence may contain it.
        abouts = {row: one.about for row, one in root.rows().items()}
        for row, group in groups.items():
            # A command of the same name in another group, such as `list`, is about something else and does not count.
            if not self.path or row == self.path[0]:
                for child in getattr(group, "commands", {}).values():
                    abouts[f"{row} {child.name}"] = child.short_help or ""
        exact = [each for each in abouts if each.split()[-1] == name and each != name] or (
            [name] if name in root.rows() else []
        )
        options = {flag: root for one in root.params for flag in one.opts if flag.startswith("--")}
        up = root.command_at("up")
        options |= {flag: up for one in up.params for flag in one.opts if flag.startswith("--")}
        if not exact and (flags := named_by(name, {flag: "" for flag in options})):
            return ": " + " or ".join(
                f"`telenano {'' if options[flag] is root else 'up fig12 '}{flag}`" for flag in flags[:_MOST_MEANT]
            )
        if not exact and len(by_text := named_by(name, abouts)) <= _MOST_MEANT:
            exact = by_text
        told = [f"`telenano {each}`: {abouts[each].rstrip('.')}" for each in exact[:_MOST_MEANT]]
        return f": {'; '.join(told)}" if told else ""


class LazyRoot(OpenGroup):
    """The group of all commands; it lists them without importing them, and prints errors that no command reports."""

    own_rows = LAZY_COMMANDS
    lists_all = False

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run a command and exit; usage errors and system errors are printed as sentences, like all other errors."""
        words, standalone = args[0] if args else extra.get("args"), extra.pop("standalone_mode", True)
        as_json = "--json" in (sys.argv[1:] if words is None else words)
        try:
            code = super().main(*args, **{**extra, "standalone_mode": False})
        # The command of a package may raise anything, also a BaseException; SystemExit carries an exit code.
        except BaseException as error:
            if not standalone or interrupts.received() or isinstance(error, SystemExit | interrupts.Interrupted):
                raise
            own = error.__cause__ if isinstance(error, interrupts.Ended) else None
            code = _report(own or error, as_json=as_json)
        if not standalone:
            return code
        sys.exit(code if isinstance(code, int) else 0)

    def command_at(self, name: str) -> Any:
        """Return a command or group of the table, imported now; None if it is unknown or its package cannot be used."""
        try:
            return load_row(name, self.rows()[name], (name,))
        except (ConfigError, KeyError):
            return None

    def make_context(self, *args: Any, **extra: Any) -> Any:
        with _unknown_to_typer():
            return super().make_context(*args, **extra)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command to run; `help` and the aliases of commands are replaced by the commands that they mean."""
        name, *rest = args or [""]
        if name == "help" and not rest:
            typer.echo(ctx.get_help())
            raise typer.Exit
        if name == "help":
            return self.resolve_command(ctx, [*rest, "--help"])
        if name in MEANT and name not in self.rows():
            ctx.fail(f"no such command {name!r}: {MEANT[name]}")
        return super().resolve_command(ctx, [ALIASES.get(name, name), *rest])

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        with _unknown_to_typer():
            return super().invoke(ctx)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands under the headings of GROUPS, each with its whole line; all of them for `--help-all`."""
        rows = self.rows()
        placed = {name for names in GROUPS.values() for name in names}
        others = tuple(name for name in rows if name not in placed)
        for heading, names in {**GROUPS, "Packages": others}.items():
            shown = [name for name in names if name in rows and (self.lists_all or name in (*FIRST_COMMANDS, *others))]
            if shown:
                with formatter.section(heading):
                    formatter.write_dl([(name, rows[name].about) for name in shown])
        if not self.lists_all:
            formatter.write_paragraph()
            formatter.write_text("`telenano --help-all` lists the other commands as well.")


@contextlib.contextmanager
def _unknown_to_typer() -> Iterator[None]:
    """Raise an interruption as an exception that typer does not catch; typer would end the command without a word."""
    try:
        yield
    except KeyboardInterrupt as error:
        raise interrupts.Ended from error


def _report(error: Any, *, as_json: bool) -> int:
    """Print an error that no command has reported and return the exit code; a fault of the core is raised again."""
    from telenano.cli.exit_codes import EXIT_BAD_CONFIGURATION, EXIT_FAILED
    from telenano.cli.output import print_error, system_error_text, usage_text
    from telenano.wire.extras import how_to_add_package, missing

    code: int
    code, text = EXIT_FAILED, plugins.fault_of_package(error)
    if isinstance(error, _UsageError):
        code = error.exit_code
        if error.format_message().startswith("Usage:"):
            # A group without a command prints its help.
            error.show()
            return code
        text = usage_text(error)
    elif isinstance(error, TelenanoError):
        code, text = EXIT_BAD_CONFIGURATION if isinstance(error, ConfigError) else EXIT_FAILED, str(error)
    elif isinstance(error, typer.Abort):
        text = "the input ended before the question was answered"
    elif isinstance(error, OSError):
        text = system_error_text(error)
    # A missing module of the core is a fault of the installation, not a missing extra.
    elif isinstance(error, ModuleNotFoundError) and (top := (error.name or "").partition(".")[0]) not in ("", *_OWN):
        name = top.replace("_", "-")
        own = f"{name} is not installed: {how_to_add_package(name)}" if name in OWN_PACKAGES else ""
        code, text = EXIT_BAD_CONFIGURATION, own or missing(top)
    if not text:
        raise error
    print_error(text, as_json=as_json)
    return code

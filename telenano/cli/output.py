"""Output of commands: errors as sentences and exit codes, results as JSON or tables."""

import contextlib
import errno
import json
import os
import re
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table

from telenano.analysis.intervals import with_error
from telenano.cli.exit_codes import EXIT_BAD_CONFIGURATION, EXIT_FAILED, EXIT_INCOMPLETE, EXIT_INTERRUPTED
from telenano.cli.tables import rows_table, summary_tables
from telenano.cli.terminal import STREAMS
from telenano.files.atomic_files import WRITE_ERRORS, new_folder, whole_results
from telenano.files.optional_modules import optional_module
from telenano.files.strict_json import finite
from telenano.settings.plugins import known_problems
from telenano.signals import interrupts
from telenano.wire.errors import (
    ConfigError,
    ExistsError,
    NoRecordingError,
    ReportError,
    TelenanoError,
    named_by,
    probably_meant,
)
from telenano.wire.printable import one_line, printable, quoted

# Windows has no such module. It is loaded here because no file can be opened any more when it is needed.
resource = optional_module("resource")
# A pipe has no width, and a line of a table that is folded there could not be searched.
_PIPE_COLUMNS = 10_000
# Of a hold in which hand and tip were both for more than this share [1], the part is not stated.
_WHOLE_SHARE = 0.995
# This is what a person can do where a rig does not reach its rate.
NO_ROOM = "the machine is too busy for this rate: end what else runs there, or give a lower realtime.rate_hz"


@contextlib.contextmanager
def report_errors(as_json: bool, interrupted: str = "interrupted") -> Iterator[None]:
    """Report a TelenanoError, what the system refuses, Ctrl-C or SIGTERM as a sentence and an exit code.

    Args:
        as_json: Whether the error is printed as JSON.
        interrupted: The text for Ctrl-C and SIGTERM.
    """
    try:
        yield
    except TelenanoError as error:
        code = (
            EXIT_BAD_CONFIGURATION if isinstance(error, ConfigError | NoRecordingError | ExistsError) else EXIT_FAILED
        )
        fail(*error.lines, code=interrupts.exit_code() or code, as_json=as_json)
    except BrokenPipeError:
        raise  # its reader has what it wanted, which `telenano.cli.app` says by the code 0
    except OSError as error:
        fail(system_error_text(error), as_json=as_json)
    except KeyboardInterrupt as error:
        # The notes say of each result that was begun whether there is anything of it.
        fail(
            "; ".join([interrupted, *getattr(error, "__notes__", ())]),
            code=interrupts.exit_code() or EXIT_INTERRUPTED,
            as_json=as_json,
        )


def say(*lines: str) -> None:
    """Print on stderr what a person is told besides the result: each text is one line, whatever names are in it."""
    typer.echo("telenano: " + "\n".join(map(one_line, lines)), err=True)


def fail(*lines: str, code: int = EXIT_FAILED, as_json: bool, **facts: Any) -> NoReturn:
    """Print an error on stderr, with `facts` as JSON on stdout if asked, and exit; each text is one line of it."""
    print_error(*lines, as_json=as_json, **facts)
    raise typer.Exit(code)


def print_error(*lines: str, as_json: bool, **facts: Any) -> None:
    """Print an error on stderr, with `facts` as JSON on stdout if asked; each text is one line of it."""
    with contextlib.suppress(OSError):
        say(*lines)
    try:
        if as_json:
            print_json({"error": "\n".join(lines), **facts})
        sys.stdout.flush()
    except OSError:
        # Output that was printed before could not be written either, nor could Python when it ends: it goes nowhere.
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def system_error_text(error: OSError) -> str:
    """Return in words what the system refused."""
    reason = error.strerror or str(error) or type(error).__name__
    if error.errno == errno.EMFILE and resource is not None:
        reason += f": this process may have {resource.getrlimit(resource.RLIMIT_NOFILE)[0]}; raise `ulimit -n`"
    # Standard output and standard error have their names in their errors (`telenano.cli.terminal`).
    if error.filename in STREAMS.values() or (error.filename is None and error.errno in WRITE_ERRORS):
        return f"{error.filename or 'a file'} cannot be written: {reason}"
    return reason if error.filename is None else f"{error.filename}: {reason}"


# What people mean by options that a session has not.
_CHECKS = "`telenano scenario check FILE` checks an experiment, and `telenano simulate` runs one without processes"
_FILE = "an experiment is given by its name or its file, as in `telenano up my.yaml`"
_MEANT = {
    "--dry-run": _CHECKS,
    "--dryrun": _CHECKS,
    "--check": _CHECKS,
    "--config": _FILE,
    "--file": _FILE,
    "-f": _FILE,
    "--loss": "--set delay_node.forward.loss.probability=0.01 loses one message in a hundred one way",
    "--jitter": "--set delay_node.forward.jitter.scale_s=0.005 makes one way uneven",
    "--delay": "--round-trip-ms 40 delays by 20 ms each way, and --set delay_node.forward.delay_s=0.04 one way alone",
    "--law": "--set controller.law=wave",
    "--rate": "--set realtime.rate_hz=500",
    "--verbose": "each node writes its log to OUT/logs, and `telenano status` shows what it does",
    "-v": "each node writes its log to OUT/logs, and `telenano status` shows what it does",
}


def usage_text(error: Any) -> str:
    """Return a usage error of the command line as a sentence."""
    message = _suggested(" ".join(error.format_message().split()).rstrip("."))
    path = error.ctx.command_path.removeprefix(error.ctx.find_root().command_path) if error.ctx else ""
    option = getattr(error, "option_name", "") if message.lower().startswith("no such option") else ""
    if path in (" up", " simulate") and (meant := _MEANT.get(option) or _meant_option(error.ctx.command, option)):
        message = f"{message.partition('; ')[0]}: {meant}"
    if not path and option:
        of_up = _long_options(error.ctx.command.command_at("up"))
        behind = f"it stands behind a command, as in `telenano up fig12 {of_up[option]}`" if option in of_up else ""
        if meant := behind or _MEANT.get(option, ""):
            message = f"{message.partition('; ')[0]}: {meant}"
    if path in (" up", " simulate") and (setting := re.search(r"extra argument\S* \(([\w.]+=\S*?)[ )]", message)):
        message = f"{message}: a key of the scenario is changed by --set {setting[1]}"
    return f"{message[:1].lower()}{message[1:]} (`telenano{path} --help` explains)"


def _long_options(command: Any) -> dict[str, str]:
    """Return the long options of a command, by themselves and by the letter that others know them by."""
    longs = [flag for one in command.params for flag in getattr(one, "opts", ()) if flag.startswith("--")]
    return {**{"-q": "--quiet", "-o": "--out"}, **{flag: flag for flag in longs}}


def _meant_option(command: Any, option: str) -> str:
    """Return which options of a session are meant by one that it has not, or the key of the scenario of this name."""
    abouts = {
        flag: one.help or "" for one in command.params for flag in getattr(one, "opts", ()) if flag.startswith("--")
    }
    if len(option) == 2:
        flags = [flag for flag in abouts if flag.startswith(f"-{option}")]
        return f"there are {', '.join(flags)}" if flags else ""
    if not option or probably_meant(option, abouts):
        return ""
    word = option.strip("-").replace("_", "-")
    if flags := named_by(word, {flag: "" for flag in abouts}):
        return f"did you mean {' or '.join(flags)}?"
    from telenano.launcher.scenario_keys import keys_named
    from telenano.wire.nodes import SERVICES

    if word in SERVICES:
        return f"its keys are changed by --set {word}.KEY=VALUE, and `telenano param list {word}` has them"
    if flags := named_by(word, abouts):
        return f"did you mean {' or '.join(flags)}?"
    if keys := keys_named(word):
        return f"a key of the scenario is changed by --set, as in --set {keys[0]}=VALUE"
    return ""


def _suggested(message: str) -> str:
    """Return a usage error with its suggestion in the words of all others, and with one where a choice has none."""
    if near := re.search(r"^(No such .+?)(?: \(Possible options?: (.+)\)|\.? Did you mean '?([^'?]+)'?\??)$", message):
        # The library gives what is near in the order of the alphabet.
        return near[1] + probably_meant(near[1].split()[-1].strip("'"), (near[2] or near[3]).split(", "))
    if choice := re.search(r"'([^']*)' is not one of ('.*')", message):
        meant = probably_meant(choice[1], re.findall(r"'([^']*)'", choice[2]))
        # What a package adds under this name may be what cannot be used.
        unusable = (text for text in known_problems() if text.startswith(f"{choice[1]} of the package "))
        return "; ".join([message + meant, *dict.fromkeys(unusable)])
    return message


@contextlib.contextmanager
def results_in(out: Path, *, at_once: bool = False) -> Iterator[Path]:
    """Yield a temporary folder whose files go into `out` when the block ends, and nowhere if it fails.

    Args:
        out: The folder of the results, which is made.
        at_once: Whether files are written to `out` itself, and stay if the block fails, as a journal does; the folder
            is removed again where it is new and stays empty.

    Raises:
        TelenanoError: The folder cannot be made.
    """
    with contextlib.ExitStack() as results:
        try:
            folder = results.enter_context(new_folder(out) if at_once else whole_results(out))
        except OSError as error:
            raise TelenanoError(f"--out {out}: cannot be made: {error.strerror}") from error
        yield folder


def print_json(document: Any) -> None:
    """Print one JSON document on a line."""
    typer.echo(json.dumps(finite(document), allow_nan=False))


def console() -> Console:
    """Return the console of standard output: plain text with a row a line for a pipe, and where NO_COLOR is set."""
    made = PrintableConsole()
    return made if made.is_terminal and not made.no_color else PlainConsole()


class PrintableConsole(Console):
    """A console whose tables and texts hold nothing that a terminal obeys, besides what draws them."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the parts of what is drawn; called for each cell of a table as well, before it is fitted."""
        for part in super().render(renderable, options):
            yield part if part.control else part._replace(text=printable(part.text))


class PlainConsole(PrintableConsole):
    """A console that draws tables without lines and without spaces at the end, for programs such as `grep`."""

    def __init__(self) -> None:
        super().__init__(width=_PIPE_COLUMNS, force_terminal=False)

    def print(self, *objects: Any, **options: Any) -> None:
        """Print, as `rich.console.Console.print`."""
        with self.capture() as captured:
            super().print(*objects, **options)
        self.file.writelines(f"{line.rstrip()}\n" for line in captured.get().splitlines())
        self.file.flush()

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the parts of what is drawn, of a table those of its cells."""
        if isinstance(renderable, Table):
            renderable.box, renderable.title_justify = None, "left"
            renderable.padding, renderable.pad_edge = (0, 2, 0, 0), False
        return super().render(renderable, options)


def print_answer(document: Any, shown: str | Sequence[Mapping[str, Any]], *, as_json: bool) -> None:
    """Print a result as JSON, or else what a person reads of it: a sentence, or rows that have the same keys."""
    if as_json:
        print_json(document)
    elif isinstance(shown, str):
        typer.echo(shown)
    else:
        print_rows(shown)


def print_document(document: dict[str, Any], title: str, *, as_json: bool) -> None:
    """Print a result as JSON or as tables."""
    if as_json:
        print_json(document)
    else:
        console().print(summary_tables(document, title))


def print_summary(summary: dict[str, Any], title: str, *, tables: bool, as_json: bool) -> None:
    """Print what happened in a session, whose folder is the title, and what to do next in three lines.

    With `tables` the summary comes first. Exit with EXIT_INCOMPLETE and a sentence when its recording is not whole.
    """
    from telenano.analysis.interruptions import Interruption, in_words

    if as_json or tables:
        print_document(summary, title, as_json=as_json)
    if not as_json:
        for line in closing_lines(summary, Path(title)):
            typer.echo(line)
    if text := clock_warning(summary):
        say(f"warning: {text}")
    for text in line_changes(summary):
        say(text)
    for felt in (summary.get("felt_stiffness") or {}).get("outside", ()):
        say(f"warning: {felt['text']}: docs/laws.md says what to do")
    if interrupted := in_words([Interruption(**one) for one in summary.get("interruptions", ())]):
        say(f"warning: this session is not its law alone: {interrupted}")
    missed, rate_hz = summary.get("overruns", 0), summary.get("rate_hz", {}).get("haptic/state", float("inf"))
    if missed > (0.005 if interrupted else 0.05) * rate_hz * summary.get("duration_s", 0.0):
        say(f"warning: {missed} deadlines were missed at {rate_hz:.0f} Hz: {NO_ROOM}")
    for text in summary["recording"].get("odd", ()):
        say(f"warning: {text}")
    if missing := summary["recording"]["missing"]:
        fail_incomplete(missing)


def closing_lines(summary: Mapping[str, Any], folder: Path) -> tuple[str, str, str]:
    """Return in three lines what happened in a session, where its picture is, and what to do next.

    A verdict other than `stable` has its reason beside it. Paths inside the working folder are relative to it.
    """
    laws = " then ".join(summary["law"])
    delay_ms = summary["link_round_trip_ms"]
    link = f", {delay_ms:g} ms by the link" if delay_ms else ""
    recording = _as_typed(Path(summary["recording"]["file"]))
    figures = [path for path in sorted(folder.glob("*")) if path.suffix in (".png", ".pdf", ".svg")]
    reason = f" ({summary['reason']})" if summary["verdict"] != "stable" and summary.get("reason") else ""
    if summary["scenario"] == "touch":
        further = f"`{own_command()} up fig12 --round-trip-ms 60` shows what delay does"
    else:
        further = f"`{own_command()} up touch` lets you press"
    return (
        f"{summary['scenario']} with {laws}{link}: {summary['verdict'].replace('_', ' ')}{reason}{_held(summary)}",
        f"picture: {_as_typed(figures[0]) if figures else 'none'}; all numbers: {_as_typed(folder / 'summary.json')}",
        f"next: `{own_command()} view {quoted(recording)}` shows it again, {further}",
    )


def _held(summary: Mapping[str, Any]) -> str:
    """Return what the hand held in a session that is stable, and in which part of its hold, as the end of a sentence.

    A session that is not stable, or in which hand and tip were not both in the hold, has nothing of the kind to say.
    """
    ratio = summary["hold_ratio"]
    if ratio is None or summary["verdict"] != "stable":
        return ""
    error = summary.get("intervals", {}).get("hold_ratio")
    own = [hold for hold in summary.get("holds", ()) if hold["hold_ratio"] is not None]
    share = own[-1].get("coupled_share", 1.0) if own else 1.0
    part = "" if share > _WHOLE_SHARE else f", in the {100.0 * share:.0f} % of the hold in which both were in it"
    return f"; the hand held {with_error(ratio, error)} N for each newton at the tip{part}"


def _as_typed(path: Path) -> str:
    """Return a path as a person in this folder would type it."""
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_absolute() and path.is_relative_to(here) else str(path)


def own_command() -> str:
    """Return how this command was called, by its name alone where the shell finds it so."""
    called = Path(sys.argv[0])
    path = shutil.which("telenano")
    if called.name != "telenano" or (path is not None and called.resolve() == Path(path).resolve()):
        return "telenano"
    return os.path.relpath(called) if called.is_absolute() else str(called)


def clock_warning(summary: Mapping[str, Any]) -> str:
    """Return in words that the sites of a session have different clocks, or may have; empty where they agree."""
    clocks = summary.get("clocks")
    if clocks is None:
        return ""
    if clocks["applied"]:
        advice = "start a time service on each machine, `telenano doctor` says how"
        return (
            f"the clocks of the sites are not synchronised: {clocks['reason']}; figures are corrected for it; {advice}"
        )
    other = clocks["otherwise"]
    if other is None or other["verdict"] == summary["verdict"]:
        return ""
    return (
        f"the clocks of the sites may not be synchronised: {clocks['reason']}; uncorrected, the session is "
        f"{summary['verdict']}, corrected for it {other['verdict']}"
    )


def line_changes(summary: Mapping[str, Any]) -> list[str]:
    """Return in words each change of the line between two sites that lasted, with what it took before and after."""
    states = summary.get("line_states", ())
    return [
        f"the way between the sites became {'longer' if now['round_trip_ms'] > before['round_trip_ms'] else 'shorter'}"
        f" at {now['from_s']:.1f} s: its round trip was {_round_trip(before)} and is {_round_trip(now)} from then on"
        for before, now in pairwise(states)
    ]


def _round_trip(state: Mapping[str, Any]) -> str:
    return f"{state['round_trip_ms']:.3g} ms ({state['low_ms']:.3g} to {state['high_ms']:.3g} ms)"


def fail_incomplete(missing: Sequence[str]) -> NoReturn:
    """Print on stderr what a recording lacks, and exit."""
    say(f"the recording is not whole: {'; '.join(missing)}")
    raise typer.Exit(EXIT_INCOMPLETE)


def fail_with_summary(error: ReportError, title: str, *, as_json: bool) -> NoReturn:
    """Print the summary of a report whose files cannot be written, the error, and exit."""
    if not as_json:
        console().print(summary_tables(error.summary, title))
    missing = error.summary["recording"]["missing"]
    also = f"; the recording is not whole: {'; '.join(missing)}" if missing else ""
    fail(f"{error}{also}", as_json=as_json, summary=error.summary)


def print_rows(rows: Sequence[Mapping[str, Any]], title: str | None = None) -> None:
    """Print rows that have the same keys as a table."""
    console().print(rows_table(rows, title=title))

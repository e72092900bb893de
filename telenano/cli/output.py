"""Output of commands: results as JSON or tables, errors as sentences with exit codes."""

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
    NoEstimateError,
    NoRecordingError,
    ReportError,
    TelenanoError,
    named_by,
    probably_meant,
)
from telenano.wire.printable import one_line, printable, quoted

# Windows has no such module. It is loaded here because it is used when the process can open no more files.
resource = optional_module("resource")
# The width for a pipe, which has none: a line that is folded there could not be searched.
_PIPE_COLUMNS = 10_000
# If hand and tip were both in the hold for more than this share [1] of it, the share is not printed.
_WHOLE_SHARE = 0.995
# The advice for a rig that does not reach its rate.
NO_ROOM = "the machine is too busy for this rate: end what else runs there, or give a lower realtime.rate_hz"


@contextlib.contextmanager
def report_errors(as_json: bool, interrupted: str = "interrupted") -> Iterator[None]:
    """Report a TelenanoError, an error of the system, Ctrl-C or SIGTERM as a sentence and an exit code.

    Args:
        as_json: Whether the error is printed as JSON.
        interrupted: The text for Ctrl-C and SIGTERM.
    """
    try:
        yield
    except TelenanoError as error:
        is_asked_wrongly = isinstance(error, ConfigError | NoRecordingError | ExistsError)
        code = EXIT_BAD_CONFIGURATION if is_asked_wrongly else EXIT_FAILED
        code = EXIT_INCOMPLETE if isinstance(error, NoEstimateError) else code
        fail(*error.lines, code=interrupts.exit_code() or code, as_json=as_json, **error.facts)
    except BrokenPipeError:
        raise  # the reader of the pipe had enough; `telenano.cli.app` exits with code 0
    except OSError as error:
        fail(system_error_text(error), as_json=as_json)
    except KeyboardInterrupt as error:
        # The notes state for each result that was begun whether any of it was written.
        fail(
            "; ".join([interrupted, *getattr(error, "__notes__", ())]),
            code=interrupts.exit_code() or EXIT_INTERRUPTED,
            as_json=as_json,
        )


def say(*lines: str) -> None:
    """Print messages besides the result on stderr, each text on one line even if a name in it has line breaks."""
    typer.echo("telenano: " + "\n".join(map(one_line, lines)), err=True)


def fail(*lines: str, code: int = EXIT_FAILED, as_json: bool, **facts: Any) -> NoReturn:
    """Print an error on stderr, a line for each text, with `facts` as JSON on stdout if asked, and exit."""
    print_error(*lines, as_json=as_json, **facts)
    raise typer.Exit(code)


def print_error(*lines: str, as_json: bool, **facts: Any) -> None:
    """Print an error on stderr, a line for each text, with `facts` as JSON on stdout if asked."""
    with contextlib.suppress(OSError):
        say(*lines)
    try:
        if as_json:
            print_json({"error": "\n".join(lines), **facts})
        sys.stdout.flush()
    except OSError:
        # Earlier output could not be written either, and Python would fail to write it when it ends: discard it.
        with contextlib.suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def system_error_text(error: OSError) -> str:
    """Return an error of the system in words."""
    reason = error.strerror or str(error) or type(error).__name__
    if error.errno == errno.EMFILE and resource is not None:
        reason += f": this process may have {resource.getrlimit(resource.RLIMIT_NOFILE)[0]}; raise `ulimit -n`"
    # `telenano.cli.terminal` puts the names of standard output and standard error into their errors.
    if error.filename in STREAMS.values() or (error.filename is None and error.errno in WRITE_ERRORS):
        return f"{error.filename or 'a file'} cannot be written: {reason}"
    return reason if error.filename is None else f"{error.filename}: {reason}"


# Hints for options that people expect and that a session does not have.
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
        from telenano.launcher.scenario_keys import keys_named

        name, _, value = setting[1].partition("=")
        # A word that is the last part of a key stands for it.
        ends = [key for key in keys_named(name) if key.endswith(f".{name}")] if "." not in name else []
        message = f"{message}: a key of the scenario is changed by --set {(ends or [name])[0]}={value}"
    return f"{message[:1].lower()}{message[1:]} (`telenano{path} --help` explains)"


def _long_options(command: Any) -> dict[str, str]:
    """Return the long options of a command, each by itself, and two of them by the letter known from other tools."""
    longs = [flag for one in command.params for flag in getattr(one, "opts", ()) if flag.startswith("--")]
    return {**{"-q": "--quiet", "-o": "--out"}, **{flag: flag for flag in longs}}


def _meant_option(command: Any, option: str) -> str:
    """Return a hint at the options of a session that an unknown option may stand for, or at a key of its name."""
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
    """Return a usage error with a suggestion in the usual words, also for a choice to which typer adds none."""
    if near := re.search(r"^(No such .+?)(?: \(Possible options?: (.+)\)|\.? Did you mean '?([^'?]+)'?\??)$", message):
        # typer lists similar names in alphabetical order; here the nearest comes first.
        return near[1] + probably_meant(near[1].split()[-1].strip("'"), (near[2] or near[3]).split(", "))
    if choice := re.search(r"'([^']*)' is not one of ('.*')", message):
        meant = probably_meant(choice[1], re.findall(r"'([^']*)'", choice[2]))
        # An extension of this name may be installed but unusable.
        unusable = (text for text in known_problems() if text.startswith(f"{choice[1]} of the package "))
        return "; ".join([message + meant, *dict.fromkeys(unusable)])
    return message


@contextlib.contextmanager
def results_in(out: Path, *, at_once: bool = False) -> Iterator[Path]:
    """Yield a temporary folder, and move its files into `out` when the block ends; if it fails, they are discarded.

    Args:
        out: The folder of the results, which is made.
        at_once: Whether files are written to `out` itself and stay if the block fails, as a journal does; a new folder
            that stays empty is removed again.

    Raises:
        TelenanoError: The folder cannot be made.
    """
    with contextlib.ExitStack() as results:
        try:
            folder = results.enter_context(new_folder(out) if at_once else whole_results(out))
        except OSError as error:
            raise TelenanoError(f"--out {out}: cannot be made: {error.strerror}") from error
        yield folder


# The documents that a command with --json has made so far; None for one that prints each at once.
_documents: list[Any] | None = None


@contextlib.contextmanager
def one_object() -> Iterator[None]:
    """Print one JSON object on standard output, and everything else that a command prints on standard error.

    A document that follows, such as that of an error after a result, adds its keys. A command that ends with an
    exception has no object: whoever reports the exception prints one.
    """
    global _documents
    ended, before = None, _documents
    documents = _documents = []
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    except (typer.Exit, SystemExit) as error:
        ended = error
    finally:
        _documents = before
    if documents:
        merged = {key: value for one in documents[1:] for key, value in one.items()}
        print_json({**documents[0], **merged} if merged else documents[0])
    if ended is not None:
        raise ended


def print_json(document: Any) -> None:
    """Print one JSON document on a line."""
    if _documents is not None:
        _documents.append(document)
    else:
        typer.echo(json.dumps(finite(document), allow_nan=False))


def console() -> Console:
    """Return the console of standard output; for a pipe, or if NO_COLOR is set, plain text with one line a row."""
    made = PrintableConsole()
    return made if made.is_terminal and not made.no_color else PlainConsole()


class PrintableConsole(Console):
    """A console that makes tables and texts printable: they hold no control characters except its own."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the segments of a renderable as printable text; called for each cell of a table before it is fitted."""
        for part in super().render(renderable, options):
            yield part if part.control else part._replace(text=printable(part.text))


class PlainConsole(PrintableConsole):
    """A console that draws tables without lines and trailing spaces, for programs such as `grep`."""

    def __init__(self) -> None:
        super().__init__(width=_PIPE_COLUMNS, force_terminal=False)

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as `rich.console.Console.print` does, without trailing spaces."""
        with self.capture() as captured:
            super().print(*objects, **options)
        self.file.writelines(f"{line.rstrip()}\n" for line in captured.get().splitlines())
        self.file.flush()

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Yield the segments of a renderable; a table is drawn without its box."""
        if isinstance(renderable, Table):
            renderable.box, renderable.title_justify = None, "left"
            renderable.padding, renderable.pad_edge = (0, 2, 0, 0), False
        return super().render(renderable, options)


def print_answer(document: Any, shown: str | Sequence[Mapping[str, Any]], *, as_json: bool) -> None:
    """Print a result as JSON, or as text for a person: a sentence, or rows that have the same keys."""
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
    """Print the outcome of a session, whose folder is the title, and the next command, in three lines and warnings.

    With `tables` the summary comes first. Exit with EXIT_INCOMPLETE and a sentence if the recording is incomplete.
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
        say(f"warning: not only the law acted in this session: {interrupted}")
    missed, rate_hz = summary.get("overruns", 0), summary.get("rate_hz", {}).get("haptic/state", float("inf"))
    if missed > (0.005 if interrupted else 0.05) * rate_hz * summary.get("duration_s", 0.0):
        say(f"warning: {missed} deadlines were missed at {rate_hz:.0f} Hz: {NO_ROOM}")
    for text in summary["recording"].get("odd", ()):
        say(f"warning: {text}")
    if missing := summary["recording"]["missing"]:
        fail_incomplete(missing)


def closing_lines(summary: Mapping[str, Any], folder: Path) -> tuple[str, str, str]:
    """Return three lines on a session: the outcome, the place of its picture, and the next command.

    A verdict other than `stable` is followed by its reason. Paths inside the working folder are relative to it.
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
    """Return the end of a sentence with the ratio of the forces at hand and tip in a stable session's hold.

    It names the part of the hold in which both were in it. It is empty for a session that is not stable, or in which
    hand and tip were not in the hold together.
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
    """Return the command as it was called, by its name alone where the shell would find it by that."""
    called = Path(sys.argv[0])
    path = shutil.which("telenano")
    if called.name != "telenano" or (path is not None and called.resolve() == Path(path).resolve()):
        return "telenano"
    return os.path.relpath(called) if called.is_absolute() else str(called)


def clock_warning(summary: Mapping[str, Any]) -> str:
    """Return a sentence if the clocks of a session's sites differ, or may differ; empty if they agree."""
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
    """Return a sentence for each lasting change of the line between two sites, with the round trip before and after."""
    states = summary.get("line_states", ())
    return [
        f"the way between the sites became {'longer' if now['round_trip_ms'] > before['round_trip_ms'] else 'shorter'}"
        f" at {now['from_s']:.1f} s: its round trip was {_round_trip(before)} and is {_round_trip(now)} from then on"
        for before, now in pairwise(states)
    ]


def _round_trip(state: Mapping[str, Any]) -> str:
    return f"{state['round_trip_ms']:.3g} ms ({state['low_ms']:.3g} to {state['high_ms']:.3g} ms)"


def fail_incomplete(missing: Sequence[str]) -> NoReturn:
    """Print on stderr what is missing in a recording, and exit with EXIT_INCOMPLETE."""
    say(f"the recording is not whole: {'; '.join(missing)}")
    raise typer.Exit(EXIT_INCOMPLETE)


def fail_with_summary(error: ReportError, title: str, *, as_json: bool) -> NoReturn:
    """Print the summary of a report whose files could not be written and the error, and exit."""
    if not as_json:
        console().print(summary_tables(error.summary, title))
    missing = error.summary["recording"]["missing"]
    also = f"; the recording is not whole: {'; '.join(missing)}" if missing else ""
    fail(f"{error}{also}", as_json=as_json, summary=error.summary)


def print_rows(rows: Sequence[Mapping[str, Any]], title: str | None = None) -> None:
    """Print rows that have the same keys as a table."""
    console().print(rows_table(rows, title=title))

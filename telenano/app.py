"""The `telenano` command. What a command needs is imported when it runs, so that `--help` is there at once."""

import contextlib
import json
import os
import signal
import sys
from collections.abc import Iterator, Sequence
from datetime import datetime
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from presets import DEFAULT_SITE_FILE, site_file_named
from proto.errors import ConfigError
from proto.nodes import SERVICES
from telenano.lazy_commands import LazyRoot
from telenano.output import EXIT_FAILED, console, fail, print_json, report_errors, tell

if TYPE_CHECKING:
    from proto.messages import SessionEvent
    from services.launcher.plan import Plan
    from services.launcher.run import Outcome
    from services.runtime.observer import Observer
    from telenano.live_view import LineView, LiveView

_LIST_S = 1.5

app = typer.Typer(
    cls=LazyRoot,
    help="A software rig for remote touch at the nanoscale: hand, delayed network, atomic force microscope.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    # markup would swallow the units in brackets
    rich_markup_mode=None,
)
topic_app = typer.Typer(help="Look at the bus of a running rig.", no_args_is_help=True, rich_markup_mode=None)
app.add_typer(topic_app, name="topic")

link_app = typer.Typer(
    help="Look at the link of a running rig, and change it.", no_args_is_help=True, rich_markup_mode=None
)
app.add_typer(link_app, name="link")

SiteFileOption = Annotated[
    Path,
    typer.Option(
        "--site-file",
        metavar="FILE",
        callback=site_file_named,
        help="Address book of the rig (YAML); default: all on this machine.",
    ),
]
RigFileOption = Annotated[
    Path | None,
    typer.Option(
        "--site-file",
        metavar="FILE",
        callback=site_file_named,
        help="Address book of the rig (YAML); default: all on this machine, with --site two of them.",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print exactly one JSON object on stdout, nothing else.")]
CountOption = Annotated[
    int | None, typer.Option("--count", min=1, metavar="N", help="End after this number of messages; default: no end.")
]
DurationOption = Annotated[
    float | None, typer.Option("--duration", min=0.0, metavar="S", help="End after this time [s]; default: no end.")
]
TopicArgument = Annotated[str, typer.Argument(metavar="TOPIC", help="Topic; topic@site is the copy out of the link.")]


class Site(StrEnum):
    """The two sites of a rig."""

    MASTER = "master"
    SLAVE = "slave"


class SessionCommand(StrEnum):
    """What a session can be told."""

    ARM = "arm"
    START = "start"
    STOP = "stop"
    ESTOP = "estop"
    SET = "set"
    MARK = "mark"


def main() -> None:
    """Run the command line."""
    app()


@app.callback(invoke_without_command=True)
def root(
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version and leave.", is_eager=True)
    ] = False,
) -> None:
    """Run a rig, look at its bus, read its recordings."""
    if show_version:
        typer.echo(version("telenano"))
        raise typer.Exit


@app.command()
def up(
    scenario: Annotated[
        str,
        typer.Option(
            "--scenario",
            metavar="NAME|FILE",
            help="Experiment to run: a known name or a YAML file. With --attach it gives name and duration only.",
        ),
    ],
    site_file: RigFileOption = None,
    site: Annotated[
        Site | None,
        typer.Option("--site", help="Run the nodes of one site here, those of the other run on another machine."),
    ] = None,
    attach: Annotated[
        bool,
        typer.Option("--attach", help="Start no node: conduct a session of nodes that somebody else runs."),
    ] = False,
    wait: Annotated[
        float | None,
        typer.Option(
            "--wait", min=0.0, metavar="S", help="Give up if nodes of somebody else are not ready by then [s]."
        ),
    ] = None,
    delay_ms: Annotated[
        float | None,
        typer.Option("--delay-ms", min=0.0, metavar="D", help="Delay of the link, one way, in both directions [ms]."),
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", help="Length of the session [s] in place of the scenario's."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder for the results; default: sessions/NAME-DATE-TIME."),
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace the results of a session that the folder holds already.")
    ] = False,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="SECTION.KEY=VALUE", help="Change one key of the scenario (SI units); may be repeated."
        ),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            "--without", metavar="NODE", help="Leave this node out, for a replay to take its place (repeatable)."
        ),
    ] = None,
    allow_replay: Annotated[
        bool, typer.Option("--allow-replay", help="Let the devices obey commands that come from a recording.")
    ] = False,
    headless: Annotated[bool, typer.Option("--headless", help="No live view, a line for each phase instead.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Start every node of a rig, run a scenario, record it, and make figure and summary."""
    from services.launcher.plan import UpRequest, make_plan
    from services.launcher.run import default_folder, report_of, run_rig

    with report_errors(as_json):
        request = UpRequest(
            scenario=scenario,
            site_file=site_file,
            delay_ms=delay_ms,
            duration_s=duration,
            out=out,
            overwrite=overwrite,
            settings=settings or (),
            without=without or (),
            allow_replay=allow_replay,
            site=None if site is None else site.value,
            attach=attach,
            wait_s=wait,
        )
        plan = make_plan(request, default_folder(scenario, datetime.now()))
        view = _view(live=not headless and not as_json, quiet=as_json)
        with view:
            outcome = run_rig(plan, view.observe, view.say)
        _default_signals()
        summary = report_of(outcome, plan, view.say)
    _tell_outcome(outcome, summary, plan, as_json=as_json)


@app.command()
def session(
    command: Annotated[SessionCommand, typer.Argument(help="What the nodes are told.")],
    parameters: Annotated[
        list[str] | None, typer.Argument(metavar="[KEY=VALUE]...", help="Parameters by dotted key, units in the names.")
    ] = None,
    target: Annotated[
        str, typer.Option("--target", metavar="NODES", help="Nodes meant: node@site, node, or a pattern such as '*'.")
    ] = "*",
    site: Annotated[
        Site | None,
        typer.Option("--site", help="Site of two at which this is typed: from the slave the nodes there are reached."),
    ] = None,
    site_file: RigFileOption = None,
    as_json: JsonOption = False,
) -> None:
    """Send a command to a running rig and wait for the answers; exit code 1 if one is refused or missing."""
    _send(command, parameters or (), target, site_file, site, as_json=as_json)


@topic_app.command("list")
def topic_list(
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    duration: Annotated[
        float, typer.Option("--duration", min=0.0, metavar="S", help="How long to listen [s].")
    ] = _LIST_S,
    as_json: JsonOption = False,
) -> None:
    """List every topic: who publishes it, its declared rate, and whether it was heard."""
    from services.runtime.observer import list_topics

    with report_errors(as_json), _observer(site_file, None) as observer:
        rows = list_topics(observer, duration)
    if as_json:
        print_json({"duration_s": duration, "topics": rows})
    else:
        _print_rows(rows)


@topic_app.command("echo")
def topic_echo(
    topic: TopicArgument,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    count: CountOption = None,
    duration: DurationOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print the messages of a topic, one a line as JSON; with --json as one object when it ends."""
    from services.runtime.observer import message_fields, messages_of

    collected: list[dict[str, Any]] = []
    with report_errors(as_json), _observer(site_file, topic) as observer, contextlib.suppress(KeyboardInterrupt):
        for received in messages_of(observer, topic, duration, count):
            fields = message_fields(received.message)
            if as_json:
                collected.append(fields)
            else:
                typer.echo(json.dumps(fields))
    if as_json:
        print_json({"topic": topic, "messages": collected})


@topic_app.command("hz")
def topic_hz(
    topic: TopicArgument,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    count: CountOption = None,
    duration: DurationOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure the rate of a topic: mean, standard deviation of the interval, gaps in the sequence."""
    from services.runtime.observer import measure_rate

    with report_errors(as_json), _observer(site_file, topic) as observer:
        rows = measure_rate(observer, topic, duration, count)
    _tell_rows(topic, rows, as_json=as_json)


@topic_app.command("delay")
def topic_delay(
    topic: TopicArgument,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    count: CountOption = None,
    duration: DurationOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure how old the messages of a topic are when they arrive here: median, 99 %, greatest [ms]."""
    from services.runtime.observer import measure_delay

    with report_errors(as_json), _observer(site_file, topic) as observer:
        rows = measure_delay(observer, topic, duration, count)
    _tell_rows(topic, rows, as_json=as_json)


@link_app.command("show")
def link_show(
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Say what the link does now: settings in force, traffic, delay applied, offset of the other site's clock."""
    from telenano.commands.link import current_status, status_rows

    with report_errors(as_json), _observer(site_file, "link/status") as observer:
        status = current_status(observer)
    if as_json:
        print_json(status)
    else:
        _print_rows(status_rows(status))


@link_app.command("set")
def link_set(
    settings: Annotated[
        list[str],
        typer.Argument(metavar="KEY=VALUE...", help="Settings by dotted key, such as forward.delay_s=0.02 (SI units)."),
    ],
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Change settings of the link for the messages that reach it from now on."""
    _change_link(settings, site_file, as_json=as_json)


@link_app.command("profile")
def link_profile(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Profile to put into force; none: list those that there are.")
    ] = None,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Put a named profile into force, in place of all settings but the seed; or list the profiles."""
    from telenano.commands.link import profile_rows

    if name is not None:
        _change_link([f"profile={name}"], site_file, as_json=as_json)
    elif as_json:
        print_json({"profiles": profile_rows()})
    else:
        _print_rows(profile_rows())


@link_app.command("clear")
def link_clear(site_file: SiteFileOption = DEFAULT_SITE_FILE, as_json: JsonOption = False) -> None:
    """Take every impairment off the link."""
    _change_link(["profile=clean"], site_file, as_json=as_json)


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


@app.command()
def report(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording (.mcap).")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for fig12.png and summary.json.")],
    as_json: JsonOption = False,
) -> None:
    """Make figure and summary from a recording once more."""
    from services.launcher.run import make_report

    with report_errors(as_json):
        summary = make_report(file, out)
    tell(summary, str(out), as_json=as_json)


def _tell_outcome(outcome: "Outcome", summary: dict[str, Any] | None, plan: "Plan", *, as_json: bool) -> None:
    if outcome.failure:
        fail(outcome.failure, as_json=as_json, summary=summary)
    if plan.site == "slave":
        kept = {"recording": str(outcome.recording or ""), "restarts": outcome.restarts}
        tell({"site": "slave", **kept}, str(plan.out), as_json=as_json)
    elif outcome.ran and plan.attach and summary is None:
        _tell_unreported(outcome, plan, as_json=as_json)
    elif summary is None:
        reason = "the recorder left no recording" if outcome.ran else "stopped before the session began"
        fail(f"{reason}, see {plan.out / 'logs'}", as_json=as_json)
    else:
        tell(summary, str(plan.out), as_json=as_json)


def _tell_unreported(outcome: "Outcome", plan: "Plan", *, as_json: bool) -> None:
    """Say of a session whose recording is elsewhere, or that nobody recorded, that it ran and what there is."""
    if as_json:
        print_json({"scenario": plan.scenario.name, "recording": None, "note": outcome.note})
    else:
        typer.echo(f"the session ran; {outcome.note}")


def _send(
    command: SessionCommand,
    parameters: Sequence[str],
    target: str,
    site_file: Path | None,
    site: Site | None = None,
    *,
    as_json: bool,
) -> None:
    from presets import DEFAULT_SITE_FILE, TWO_SITES_FILE
    from services.launcher.command_client import ControlRequest, parse_parameters, send_control

    with report_errors(as_json):
        book_file = site_file or (DEFAULT_SITE_FILE if site is None else TWO_SITES_FILE)
        at: Literal["master", "slave"] = "master" if site is None else site.value
        request = ControlRequest(command.value, target, parse_parameters(parameters), book_file, at)
        answers = send_control(request, lambda event: None if as_json else _tell_answer(event))
    if as_json:
        rows = {src: {"kind": event.kind, "text": event.text} for src, event in sorted(answers.items())}
        print_json({"command": command.value, "target": target, "answers": rows})
    if any(event.kind == "refused" for event in answers.values()):
        raise typer.Exit(EXIT_FAILED)


def _change_link(settings: Sequence[str], site_file: Path, *, as_json: bool) -> None:
    _send(SessionCommand.SET, settings, "delay_node", site_file, as_json=as_json)


def _tell_answer(event: "SessionEvent") -> None:
    typer.echo(f"{event.src} {event.kind}: {event.text}")


def _tell_rows(topic: str, rows: list[dict[str, Any]], *, as_json: bool) -> None:
    if as_json:
        print_json({"topic": topic, "sources": rows})
    else:
        _print_rows(rows)


def _print_rows(rows: list[dict[str, Any]]) -> None:
    from telenano.live_view import rows_table

    console().print(rows_table(rows))


def _view(*, live: bool, quiet: bool) -> "LiveView | LineView":
    from telenano.live_view import LineView, LiveView

    out = console()
    return LiveView(out) if live and out.is_terminal else LineView(out, quiet=quiet)


def _default_signals() -> None:
    """Let Ctrl-C end what follows the session at once: no process has to be made safe any more."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)


@contextlib.contextmanager
def _observer(site_file: Path, topic: str | None) -> Iterator["Observer"]:
    from services.runtime.main import load_site
    from services.runtime.observer import Observer, known_name

    book = load_site(site_file)
    observer = Observer(book, (known_name(topic)[0],)) if topic else Observer(book)
    try:
        yield observer
    finally:
        observer.close()

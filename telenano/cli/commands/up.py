"""`telenano up`: run a scenario on a rig, record it, and write figure and summary."""

import signal
import sys
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from presets.plugins import known_problems
from proto.errors import ConfigError, ReportError
from recording.multi_file import open_recordings
from services.launcher.page import inherited_by_page
from services.launcher.plan import Plan, UpRequest, make_plan
from services.launcher.run import Outcome, default_folder, report_of, run_rig
from services.signals import interrupts
from services.viz_node.figure_style import FigureOptions, figure_options
from telenano.cli.completion import node_names, scenario_names
from telenano.cli.exit_codes import EXIT_BAD_CONFIGURATION, EXIT_FAILED
from telenano.cli.live_view import LineView, LiveView
from telenano.cli.options import FormatOption, JsonOption, RigFileOption, Site, StyleOption
from telenano.cli.output import (
    console,
    fail,
    fail_incomplete,
    fail_with_summary,
    print_document,
    print_json,
    print_summary,
    report_errors,
)


def up(
    scenario: Annotated[
        str,
        typer.Option(
            "--scenario",
            metavar="NAME|FILE",
            help="Experiment to run: a known name or a YAML file. With --attach it gives name and duration only.",
            autocompletion=scenario_names,
        ),
    ],
    site_file: RigFileOption = None,
    site: Annotated[
        Site | None,
        typer.Option("--site", help="Run the nodes of one site here; those of the other run on another machine."),
    ] = None,
    attach: Annotated[
        bool,
        typer.Option("--attach", help="Start no node: run a session with nodes that were started elsewhere."),
    ] = False,
    wait: Annotated[
        float | None,
        typer.Option(
            "--wait", min=0.0, metavar="S", help="Give up if nodes started elsewhere are not ready after this time [s]."
        ),
    ] = None,
    round_trip_ms: Annotated[
        float | None,
        typer.Option("--round-trip-ms", min=0.0, metavar="D", help="Delay of the link, half of it each way [ms]."),
    ] = None,
    delay_ms: Annotated[
        float | None,
        typer.Option("--delay-ms", min=0.0, metavar="D", help="The same, one way: half of --round-trip-ms [ms]."),
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
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            "--sweep",
            metavar="KEY=V1,V2",
            help="Run a session for each value of a key, or of round_trip_ms, and compare them (repeatable).",
        ),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            "--without",
            metavar="NODE",
            help="Leave this node out, for a replay to take its place (repeatable).",
            autocompletion=node_names,
        ),
    ] = None,
    allow_replay: Annotated[
        bool, typer.Option("--allow-replay", help="Let the devices obey commands that come from a recording.")
    ] = False,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    headless: Annotated[
        bool, typer.Option("--headless", help="Print a line for each phase instead of the live view.")
    ] = False,
    no_view: Annotated[
        bool, typer.Option("--no-view", help="Serve no page; --json, --headless and --site slave serve none either.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Start every node of a rig, run a scenario, record it, and write figure and summary."""
    with report_errors(as_json):
        options = figure_options(formats, style)
        if round_trip_ms is not None and delay_ms is not None:
            raise ConfigError("--round-trip-ms, --delay-ms: the same delay, there and back and one way: give one")
        delay_ms = 0.5 * round_trip_ms if round_trip_ms is not None else delay_ms
        if sweep:
            _sweep(sweep, scenario, out, options, as_json=as_json)
            return
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
            page=not (no_view or as_json or headless),
        )
        plan = make_plan(request, default_folder(scenario, datetime.now()))
        if delay_ms is not None and round_trip_ms is None:
            text = f"--delay-ms {delay_ms:g} is one way: a round trip of {2 * delay_ms:g} ms"
            typer.echo(f"telenano: {text}, as --round-trip-ms {2 * delay_ms:g}", err=True)
        for text in known_problems():
            typer.echo(f"telenano: {text}; it is left out", err=True)
        if text := _clock_text(plan):
            typer.echo(f"telenano: warning: {text}", err=True)
        if plan.warning:
            typer.echo(f"telenano: {plan.warning}", err=True)
        view = _open_view(live=not headless and not as_json, quiet=as_json)
        with inherited_by_page(plan, typer.echo) as beside, view:
            outcome = run_rig(plan, view.observe, view.show, beside)
        _restore_default_signals()
        try:
            summary = report_of(outcome, plan, view.show, options)
        except ReportError as error:
            fail_with_summary(error, str(plan.out), as_json=as_json)
    _print_outcome(outcome, summary, plan, as_json=as_json)


def _clock_text(plan: Plan) -> str:
    """Return in words that this machine's clock is not synchronised, where the rig spans two; else nothing."""
    if not plan.book.spans_machines:
        return ""
    # it needs POSIX, and the other commands work without
    from telenano.doctor import checks

    found = checks.check_synchronised(checks.kernel_clock())
    return "" if found.level == "ok" else f"the clock of this machine is {found.found}; {found.advice}"


def _sweep(given: list[str], scenario: str, out: Path | None, options: FigureOptions, *, as_json: bool) -> None:
    """Run this very command once for each point of a sweep, and compare the sessions."""
    from telenano.cli.commands.compare import compare_sessions, print_comparison
    from telenano.cli.sweep import points_of, run_sweep, without_sweep

    folder = out or default_folder(scenario, datetime.now())
    points = points_of(given)
    folders = run_sweep(points, without_sweep(sys.argv), folder, lambda text: typer.echo(text, err=True))
    print_comparison(compare_sessions(folders, folder, options), folder, as_json=as_json)


def _open_view(*, live: bool, quiet: bool) -> LiveView | LineView:
    out = console()
    return LiveView(out) if live and out.is_terminal else LineView(out, quiet=quiet)


def _restore_default_signals() -> None:
    """Let Ctrl-C end what follows the session at once: no process has to be made safe any more."""
    signal.set_wakeup_fd(-1)
    interrupts.handle()


def _print_outcome(outcome: Outcome, summary: dict[str, Any] | None, plan: Plan, *, as_json: bool) -> None:
    if outcome.failure:
        code = EXIT_BAD_CONFIGURATION if outcome.bad_start else EXIT_FAILED
        fail(outcome.failure, code, as_json=as_json, summary=summary)
    if plan.site == "slave":
        _print_slave(outcome, plan, as_json=as_json)
    elif summary is not None:
        print_summary(summary, str(plan.out), as_json=as_json)
    elif not (outcome.ran and plan.attach):
        reason = "the recorder left no recording" if outcome.ran else "stopped before the session began"
        fail("; ".join([reason, *outcome.missing, f"see {plan.out / 'logs'}"]), as_json=as_json)
    elif as_json:
        # the recording is elsewhere, or nobody recorded
        print_json({"scenario": plan.scenario.name, "recording": None, "note": outcome.note})
    else:
        typer.echo(f"the session ran; {outcome.note}")


def _print_slave(outcome: Outcome, plan: Plan, *, as_json: bool) -> None:
    kept: dict[str, Any] = {"file": "", "complete": None, "missing": list(outcome.missing)}
    if outcome.recordings:
        info = open_recordings(outcome.recordings).info()
        missing = [*info.missing, *outcome.missing]
        kept = {"file": info.path, "complete": not missing, "missing": missing, "messages": info.messages}
    # the path by itself, as ever
    document = {"site": "slave", "recording": kept["file"], "recorded": kept, "restarts": outcome.restarts}
    print_document(document, str(plan.out), as_json=as_json)
    if kept["missing"]:
        fail_incomplete(kept["missing"])

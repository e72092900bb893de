"""`telenano simulate`: run a scenario in virtual time, record it, and write figure and summary."""

import sys
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.analysis.figure_style import FigureOptions
from telenano.cli.completion import scenario_names
from telenano.cli.exit_codes import EXIT_BAD_CONFIGURATION, EXIT_FAILED
from telenano.cli.lazy_commands import function_of_package
from telenano.cli.live_view import LineView
from telenano.cli.model_options import SECONDS, Given, validated, with_options
from telenano.cli.option_rules import Keys, Void, rules
from telenano.cli.options import (
    AllowCodeOption,
    FormatOption,
    JobsOption,
    JsonOption,
    QuietOption,
    SeedsOption,
    StyleOption,
    TableOption,
    table_formats,
)
from telenano.cli.output import (
    console,
    fail,
    fail_with_summary,
    print_answer,
    print_summary,
    report_errors,
    say,
)
from telenano.cli.sweep import SEED, SESSION_RULES, plan_sweep, points_of, run_sweep, without_sweep
from telenano.launcher.plan import Plan
from telenano.launcher.run import Outcome, default_folder, report_of, reserved_folder
from telenano.settings.config import permit_code
from telenano.settings.plugins import known_problems
from telenano.settings.scenario import SEEDS
from telenano.virtual.request import SimulateRequest, plan_of, run_plan
from telenano.wire.errors import ConfigError, ReportError


@rules(
    *SESSION_RULES,
    Keys("--seed", ", ".join((SEED, *SEEDS))),
    Void("--jobs", "which is one session", unless="--sweep, --seeds"),
    Keys("--both-sites", "recorder.far"),
    Void("--format, --style", "which leaves out the figure", beside="--no-report", unless="--sweep, --seeds"),
)
@with_options(SimulateRequest, ("scenario",), units=SECONDS)
def simulate(
    given: Given,
    scenario: Annotated[
        str,
        typer.Argument(
            metavar="[NAME|FILE]",
            help="Experiment to run: a known name or a YAML file.",
            autocompletion=scenario_names,
        ),
    ] = "fig12",
    sweep: Annotated[
        list[str] | None,
        typer.Option(
            "--sweep",
            metavar="KEY=V1,V2",
            help="Run a session for each value of a key, of seed, or of round_trip_ms, and compare them (repeatable).",
        ),
    ] = None,
    seeds: SeedsOption = None,
    allow_code: AllowCodeOption = False,
    no_report: Annotated[
        bool, typer.Option("--no-report", help="Write the recording alone; `telenano report` makes the rest later.")
    ] = False,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    table: TableOption = "csv",
    jobs: JobsOption = None,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Run the nodes of a rig on a bus in memory, in virtual time, and write recording, figure and summary.

    The same seed gives the same messages at the same times on every processor. All devices have to be simulated.
    """
    if allow_code:
        permit_code()
    with report_errors(as_json):
        options = FigureOptions.of(formats, style)
        request = validated(SimulateRequest, {**given, "scenario": scenario})
        repeated = [] if seeds is None else [f"{SEED}={','.join(map(str, range(seeds)))}"]
        if sweep or repeated:
            values = [*(sweep or ()), *repeated]
            _sweep(values, request, options, table, jobs=jobs, quiet=quiet, as_json=as_json)
            return
        view = LineView(console(), quiet=quiet or as_json)
        if request.out is not None:
            outcome, summary, plan = _run(request, request.out, options, view, report=not no_report, as_json=as_json)
        else:
            with reserved_folder(scenario, datetime.now()) as folder:
                outcome, summary, plan = _run(request, folder, options, view, report=not no_report, as_json=as_json)
    if outcome.failure:
        code = EXIT_BAD_CONFIGURATION if outcome.bad_start else EXIT_FAILED
        fail(*outcome.failure.split("\n"), code=code, as_json=as_json, summary=summary)
    if summary is not None:
        print_summary(summary, str(plan.out), tables=False, as_json=as_json)
    elif not outcome.recordings:
        fail("; ".join(["the session left no recording", *outcome.missing]), as_json=as_json)
    else:
        recording = str(outcome.recordings[-1])
        print_answer({"recording": recording}, recording, as_json=as_json)


def _run(
    request: SimulateRequest, folder: Path, options: FigureOptions, view: LineView, *, report: bool, as_json: bool
) -> tuple[Outcome, dict[str, Any] | None, Plan]:
    plan = plan_of(request, folder)
    for text in (*known_problems(), plan.warning, plan.stiffness_warning):
        if text:
            say(f"warning: {text}")
    outcome = run_plan(plan, request, view.observe, view.show)
    if not report:
        return outcome, None, plan
    try:
        return outcome, report_of(outcome, plan, view.show, options), plan
    except ReportError as error:
        fail_with_summary(error, str(plan.out), as_json=as_json)


def _sweep(
    values: list[str],
    request: SimulateRequest,
    options: FigureOptions,
    tables: str,
    *,
    jobs: int | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Run this command once for each point of a sweep, then compare the sessions with the command of a package."""
    table_formats(tables)
    compare = function_of_package("compare")
    folder = request.out or default_folder(request.scenario, datetime.now())
    points = points_of(values, seed_option="--seed")
    if len(points) < 2:
        raise ConfigError("--sweep: gives one session, and needs two or more to compare")
    kept, settings = plan_sweep(points, request, folder, lambda asked: plan_of(asked, folder))
    words = without_sweep(sys.argv, "simulate")
    words = words if request.scenario in words else [request.scenario, *words]
    folders = run_sweep(points, words, folder, kept, settings, jobs=jobs, quiet=quiet, name="simulate")
    formats = ",".join(options.formats)
    compare(folders, folder, formats=formats, style=options.style, table=tables, as_json=as_json)

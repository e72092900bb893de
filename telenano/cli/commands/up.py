"""`telenano up`: run a scenario on a rig, record it, and write figure and summary."""

import contextlib
import signal
import sys
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.analysis.figure_style import FigureOptions
from telenano.cli.completion import scenario_names
from telenano.cli.exit_codes import EXIT_BAD_CONFIGURATION, EXIT_FAILED
from telenano.cli.lazy_commands import function_of_package
from telenano.cli.live_view import LineView, LiveView
from telenano.cli.model_options import SECONDS, Given, validated, with_options
from telenano.cli.option_rules import Keys, Void, rules
from telenano.cli.options import (
    AllowCodeOption,
    FormatOption,
    JsonOption,
    QuietOption,
    SeedsOption,
    StyleOption,
    TableOption,
)
from telenano.cli.output import (
    console,
    fail,
    fail_incomplete,
    fail_with_summary,
    print_answer,
    print_document,
    print_summary,
    report_errors,
    say,
)
from telenano.cli.sweep import SEED, SESSION_RULES
from telenano.launcher.disk_space import check_room
from telenano.launcher.fan_out import fan_out
from telenano.launcher.page import NO_PAGE, inherited_by_page
from telenano.launcher.plan import Plan, UpRequest, make_plan
from telenano.launcher.rigs import own_rig
from telenano.launcher.run import Outcome, default_folder, report_of, reserved_folder, run_rig, with_far_recording
from telenano.recording.multi_file import open_recordings
from telenano.runtime.security.keyring import Keyring
from telenano.settings.config import permit_code
from telenano.settings.plugins import known_problems
from telenano.signals import interrupts
from telenano.wire.errors import ConfigError, ReportError

_CONDUCTED = "where no session is conducted: give it at the master"


@rules(
    *SESSION_RULES,
    Keys("--allow-replay", "afm_node.allow_replay, haptic_node.allow_replay"),
    Keys("--attended", "afm_node.attended"),
    Void("--scenario", "which names the experiment", beside="NAME|FILE"),
    Void(
        "--set, --instrument, --round-trip-ms, --without, --allow-replay, --attended, --allow-code, --sweep, --seeds",
        "which starts no node: give it where the nodes are started",
        beside="--attach",
    ),
    Void("--attach, --duration, --wait, --sweep, --seeds, --format, --style", _CONDUCTED, beside="--site slave"),
    Void("--round-trip-ms", "where no link runs: give it at the master", beside="--site slave"),
    Void("--wait", "which wait for nodes that run elsewhere", unless="--attach, --site"),
    Void("--headless", "which prints no line for a phase", beside="--quiet, --sweep, --seeds"),
)
@with_options(UpRequest, ("page", "scenario"), units=SECONDS)
def up(
    given: Given,
    experiment: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME|FILE]",
            show_default=False,
            help="Experiment to run: a known name or a YAML file; with --attach it gives name and duration only.",
            autocompletion=scenario_names,
        ),
    ] = None,
    scenario: Annotated[
        str | None,
        typer.Option(
            "--scenario", metavar="NAME|FILE", help="The experiment as an option.", autocompletion=scenario_names
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
    seeds: SeedsOption = None,
    allow_code: AllowCodeOption = False,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    table: TableOption = "csv",
    headless: Annotated[
        bool, typer.Option("--headless", help="Print a line for each phase instead of the live view.")
    ] = False,
    no_view: Annotated[
        bool,
        typer.Option("--no-view", help="Serve no page; --json, --headless, --quiet and --site slave imply this."),
    ] = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Start every node of a rig, run a scenario, record it, and write figure and summary."""
    if allow_code:
        # The nodes inherit the permission, and so do the sessions of a sweep.
        permit_code()
    with report_errors(as_json):
        options = FigureOptions.of(formats, style)
        asked = {"scenario": _experiment(experiment, scenario)}
        request = validated(UpRequest, {**given, **asked, "page": not (no_view or as_json or headless or quiet)})
        repeated = [] if seeds is None else [f"{SEED}={','.join(map(str, range(seeds)))}"]
        if sweep or repeated:
            _sweep([*(sweep or ()), *repeated], request, options, table, quiet=quiet, as_json=as_json)
            return
        with _folder_of(request) as folder:
            outcome, summary, plan = _run(request, folder, options, headless=headless, quiet=quiet, as_json=as_json)
    _print_outcome(outcome, summary, plan, as_json=as_json)


def _experiment(argument: str | None, option: str | None) -> str:
    """Return the experiment that is named, by the argument or by the option; ConfigError for none."""
    if argument is None and option is None:
        raise ConfigError("no experiment is named, such as in `telenano up fig12` (`telenano up --help` explains)")
    return argument or option or ""


def _folder_of(request: UpRequest) -> contextlib.AbstractContextManager[Path]:
    """Return a context with the folder of a session: the one of the request, or else a newly reserved one."""
    if request.out is not None:
        return contextlib.nullcontext(request.out)
    return reserved_folder(request.scenario, datetime.now())


def _run(
    request: UpRequest, folder: Path, options: FigureOptions, *, headless: bool, quiet: bool, as_json: bool
) -> tuple[Outcome, dict[str, Any] | None, Plan]:
    """Run the session in a folder and make its report."""
    plan = make_plan(request, folder)
    _warn(request, plan)
    check_room(plan)
    view = _open_view(live=not (headless or quiet or as_json), quiet=quiet or as_json)

    def tell_of_page(text: str) -> None:
        typer.echo(text)
        if text.startswith(NO_PAGE) and isinstance(view, LiveView):
            view.footnote = text

    with (
        own_rig(plan, _tell) as own,
        fan_out(plan, own.descriptors),
        inherited_by_page(plan, tell_of_page) as beside,
        view,
    ):
        outcome = run_rig(plan, view.observe, view.show, beside, own.descriptors, own.place)
    with outcome.report_later(plan):
        _restore_default_signals()
        outcome = with_far_recording(outcome, plan, view.show)
        try:
            return outcome, report_of(outcome, plan, view.show, options), plan
        except ReportError as error:
            fail_with_summary(error, str(plan.out), as_json=as_json)


def _warn(request: UpRequest, plan: Plan) -> None:
    """Print warnings about a session that is about to start, such as packages that are left out or keys that expire."""
    for text in known_problems():
        _tell(f"{text}; it is left out")
    if text := _clock_text(plan):
        _tell(f"warning: {text}")
    for text in Keyring().expiring() if plan.book.requires_keys else ():
        _tell(f"warning: {text}: `telenano doctor` says what to do")
    for text in plan.cautions:
        _tell(f"warning: {text}")
    if plan.warning:
        _tell(plan.warning)
    if text := plan.stiffness_warning:
        _tell(f"warning: {text}")


def _tell(text: str) -> None:
    say(text)


def _clock_text(plan: Plan) -> str:
    """Return a sentence if the rig spans two machines and this machine's clock is not synchronised; else empty."""
    if not plan.book.spans_machines:
        return ""
    # Imported here, because it needs POSIX, and the other commands work without it.
    from telenano.doctor import checks

    finding = checks.check_synchronised(checks.kernel_clock())
    return "" if finding.level == "ok" else f"the clock of this machine is {finding.found}; {finding.advice}"


def _sweep(
    values: list[str], request: UpRequest, options: FigureOptions, tables: str, *, quiet: bool, as_json: bool
) -> None:
    """Run this command once for each point of a sweep, then compare the sessions with the command of a package."""
    from telenano.cli.sweep import plan_sweep, points_of, run_sweep, without_sweep

    compare = function_of_package("compare")
    folder = request.out or default_folder(request.scenario, datetime.now())
    points = points_of(values)
    if len(points) < 2:
        raise ConfigError("--sweep: gives one session, and needs two or more to compare")
    kept, settings = plan_sweep(points, request, folder, lambda asked: make_plan(asked, folder))
    folders = run_sweep(points, without_sweep(sys.argv), folder, kept, settings, quiet=quiet)
    formats = ",".join(options.formats)
    compare(folders, folder, formats=formats, style=options.style, table=tables, as_json=as_json)


def _open_view(*, live: bool, quiet: bool) -> LiveView | LineView:
    out = console()
    return LiveView(out) if live and out.is_terminal else LineView(out, quiet=quiet)


def _restore_default_signals() -> None:
    """Let Ctrl-C end the command at once from now on: after the session no process has to be made safe."""
    signal.set_wakeup_fd(-1)
    interrupts.handle()


def _print_outcome(outcome: Outcome, summary: dict[str, Any] | None, plan: Plan, *, as_json: bool) -> None:
    if outcome.failure:
        code = EXIT_BAD_CONFIGURATION if outcome.bad_start else EXIT_FAILED
        fail(*outcome.failure.split("\n"), code=code, as_json=as_json, summary=summary)
    if plan.site == "slave":
        _print_slave(outcome, plan, as_json=as_json)
    elif summary is not None:
        print_summary(summary, str(plan.out), tables=False, as_json=as_json)
    elif not (outcome.ran and plan.attach):
        reason = "the recorder left no recording" if outcome.ran else "stopped before the session began"
        fail("; ".join([reason, *outcome.missing, f"see {plan.out / 'logs'}"]), as_json=as_json)
    else:
        # The recording is made elsewhere, or there was no recorder.
        document = {"scenario": plan.scenario.name, "recording": None, "note": outcome.note}
        print_answer(document, f"the session ran; {outcome.note}", as_json=as_json)


def _print_slave(outcome: Outcome, plan: Plan, *, as_json: bool) -> None:
    kept: dict[str, Any] = {"file": "", "complete": None, "missing": list(outcome.missing)}
    if outcome.recordings:
        info = open_recordings(outcome.recordings, same_session=True).info()
        missing = [*info.missing, *outcome.missing]
        kept = {"file": info.path, "complete": not missing, "missing": missing, "messages": info.messages}
    # `recording` holds the path alone, as in earlier versions.
    document = {"site": "slave", "recording": kept["file"], "recorded": kept, "restarts": outcome.restarts}
    print_document(document, str(plan.out), as_json=as_json)
    if kept["missing"]:
        fail_incomplete(kept["missing"])

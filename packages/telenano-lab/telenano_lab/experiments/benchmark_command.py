"""`telenano benchmark`: the law for each network, by fixed tasks, networks and hands; the same bits everywhere."""

import tempfile
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from telenano.analysis import FigureOptions, cell_text
from telenano.cli import (
    EXIT_FAILED,
    FormatOption,
    JsonOption,
    StyleOption,
    Void,
    law_names,
    print_json,
    print_rows,
    report_errors,
    results_in,
    rules,
)
from telenano_lab.studies import option_values
from telenano_lab.studies.loops.sweep import Kind, Sweep
from telenano_lab.studies.study_options import SchedulerOption, WorkersOption
from telenano_lab.studies.study_results import INTERRUPTED, print_result, sweep_in, write_study

# The option of each field of a run.
_OF_FIELDS = {"law": "--law", "network": "--network", "instrument": "--instrument", "steadiness": "--hand",
              "task": "--task", "hand": "--arm", "seed": "--seed"}  # fmt: skip


@rules(
    Void("--task, --arm, --seed, --draw, --draw-seed", "without which the whole set is run", unless="WHAT cell"),
    Void(
        "--quick, --set, --scheduler, --out, --format, --style",
        "whose runs are made again as they were kept, and leave no page",
        beside="WHAT cell",
    ),
    Void("--draw-seed", "which draws", unless="--draw"),
)
def benchmark(
    what: Annotated[
        Literal["all", "cell"],
        typer.Argument(help="all: the benchmark; cell: make kept runs again, and compare them."),
    ] = "all",
    out: Annotated[
        Path,
        typer.Option("--out", metavar="DIR", help="Folder for page, tables and journal; resumes a journal."),
    ] = Path("out/benchmark"),
    law: Annotated[
        str,
        typer.Option("--law", metavar="LAW[,LAW]|all", help="Laws to run, also of packages.", autocompletion=law_names),
    ] = "all",
    network: Annotated[
        str, typer.Option("--network", metavar="NAME[,NAME]", help="Networks instead of those of the benchmark.")
    ] = "",
    instrument: Annotated[
        str, typer.Option("--instrument", metavar="NAME[,NAME]", help="Instruments instead of ideal,real.")
    ] = "",
    hand: Annotated[
        str, typer.Option("--hand", metavar="NAME[,NAME]", help="scripted, trembling, or both, which is the default.")
    ] = "",
    quick: Annotated[bool, typer.Option("--quick", help="Four networks, two tasks, two hands and two seeds.")] = False,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="LAW.KEY=VALUE", help="Change a parameter of a law (SI units); may be repeated."),
    ] = None,
    task: Annotated[
        str, typer.Option("--task", metavar="NAME[,NAME]", help="Tasks of a cell: touch, hold, track, stiff.")
    ] = "",
    arm: Annotated[
        str, typer.Option("--arm", metavar="NAME[,NAME]", help="Hands of a cell: force, soft, stiff, reacting.")
    ] = "",
    seed: Annotated[str, typer.Option("--seed", metavar="N[,N]", help="Seeds of the runs of a cell.")] = "",
    draw: Annotated[
        int | None, typer.Option("--draw", min=1, metavar="N", help="Draw N of the runs of a cell, or of all.")
    ] = None,
    draw_seed: Annotated[int, typer.Option("--draw-seed", min=0, help="Seed of the draw.")] = 0,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    as_json: JsonOption = False,
) -> None:
    """Run the benchmark of laws: fixed tasks, networks and hands in lockstep; one page, and a digest of the runs.

    With `cell` the runs that are named are made again and compared with those kept with the package; the exit code is 1
    if one differs.
    """
    with report_errors(as_json, INTERRUPTED):
        if what == "all":
            choice = {"--network": network, "--instrument": instrument, "--hand": hand}
            options = FigureOptions.of(formats, style)
            sweep = sweep_in(out, workers, scheduler, shown=not as_json, kind=_runs())
            _run_all(law, choice, settings or (), out, sweep, options, quick=quick, as_json=as_json)
            return
        wanted: dict[str, list[Any]] = {
            "law": [] if law == "all" else _names(law),
            "network": _names(network.lower()),
            "instrument": _names(instrument),
            "steadiness": _names(hand),
            "task": _names(task),
            "hand": _names(arm),
            "seed": _numbers(seed),
        }
        same = _run_cell(wanted, draw, draw_seed, workers, as_json=as_json)
    if not same:
        raise typer.Exit(EXIT_FAILED)


def _runs() -> Kind:
    from telenano_lab.experiments.benchmark.run import RUNS

    return RUNS


def _run_all(
    law: str,
    choice: dict[str, str],
    settings: Sequence[str],
    out: Path,
    opened: AbstractContextManager[Sweep],
    options: FigureOptions,
    *,
    quick: bool,
    as_json: bool,
) -> None:
    from telenano_lab.experiments.benchmark.plan import plan_of
    from telenano_lab.experiments.benchmark.results import rows_of, runs_text, situations_of, summary_of
    from telenano_lab.experiments.benchmark_page import (
        CHOICE_HEAD,
        SITUATION_HEAD,
        benchmark_figure,
        benchmark_page,
        choice_rows,
        frontier_figure,
        situation_rows,
    )
    from telenano_lab.studies.image_files import write_images

    plan = plan_of(
        option_values.laws(law),
        quick=quick,
        networks=_names(choice["--network"]),
        instruments=_names(choice["--instrument"]),
        steadiness=_names(choice["--hand"]),
        settings=option_values.settings(settings),
    )
    command = _command(law, choice, quick=quick, settings=settings)
    with opened as sweep:
        outcomes = sweep.run(plan.runs())
    rows, situations = rows_of(outcomes), situations_of(outcomes)
    summary = summary_of(plan, outcomes, rows, situations)
    with results_in(out) as folder:
        (folder / "runs.csv").write_text(runs_text(outcomes), encoding="utf-8", newline="")
        with options.styled():
            figures = {"benchmark": benchmark_figure(rows)}
            if situations:
                figures["frontier"] = frontier_figure(situations)
            images = write_images(folder, figures, command, options)
        write_study(folder, benchmark_page(plan, summary, rows, situations, images, command), summary)
    # Networks that represent no kind of line are shown individually.
    head, table = (SITUATION_HEAD, situation_rows(situations)) if situations else (CHOICE_HEAD, choice_rows(rows))
    print_result(summary, head, table, out, as_json=as_json)
    if not as_json:
        typer.echo(f"digest: {summary['digest']}")


def _run_cell(
    wanted: dict[str, list[Any]], draw: int | None, draw_seed: int, workers: int | None, *, as_json: bool
) -> bool:
    """Repeat kept runs, print kept and new outcomes, and return whether all are equal."""
    from telenano_lab.experiments.benchmark.cell import CELL_HEAD, compared, named_runs
    from telenano_lab.experiments.benchmark.kept import kept

    table = kept()
    before = named_runs(table, wanted, _OF_FIELDS, draw, draw_seed)
    with (
        tempfile.TemporaryDirectory() as folder,
        sweep_in(Path(folder) / "cell", workers, None, shown=not as_json, kind=_runs()) as sweep,
    ):
        again = sweep.run([outcome.cell for outcome in before])
    summary, rows = compared(before, again, table.digest)
    if as_json:
        print_json(summary)
    else:
        print_rows([dict(zip(CELL_HEAD, map(cell_text, row), strict=True)) for row in rows])
        typer.echo(
            f"{summary['runs']} runs, {summary['held_kept']} held as kept and {summary['held_now']} now;"
            f" {summary['different']} differ from the kept ones, whose digest is {table.digest}"
        )
    return not summary["different"]


def _numbers(text: str) -> list[int]:
    return [round(value) for value in option_values.numbers("--seed", text, 0, 1e6, "")] if text else []


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _command(law: str, choice: dict[str, str], *, quick: bool, settings: Sequence[str]) -> str:
    """Return the command that makes this result, without its output folder."""
    words = ["telenano benchmark", *(["--quick"] if quick else []), *([f"--law {law}"] if law != "all" else [])]
    words += [f"{option} {names}" for option, names in choice.items() if names]
    return " ".join([*words, *(f"--set {setting}" for setting in settings)])

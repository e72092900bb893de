"""`telenano benchmark`: which law for which network, by fixed tasks, networks and hands; the same bits everywhere."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.analysis import FigureOptions
from telenano.cli import FormatOption, JsonOption, StyleOption, law_names, report_errors, results_in
from telenano_lab.studies import option_values
from telenano_lab.studies.study_options import SchedulerOption, WorkersOption
from telenano_lab.studies.study_results import INTERRUPTED, print_result, sweep_in, write_study


def benchmark(
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
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    as_json: JsonOption = False,
) -> None:
    """Run the benchmark of laws: fixed tasks, networks and hands in lockstep; one page, and a digest of the runs."""
    with report_errors(as_json, INTERRUPTED):
        from telenano_lab.experiments.benchmark.plan import plan_of
        from telenano_lab.experiments.benchmark.results import rows_of, runs_text, situations_of, summary_of
        from telenano_lab.experiments.benchmark.run import RUNS
        from telenano_lab.experiments.benchmark_page import (
            CHOICE_HEAD,
            SITUATION_HEAD,
            benchmark_figure,
            benchmark_page,
            choice_rows,
            frontier_figure,
            situation_rows,
        )
        from telenano_lab.studies.page import write_images

        plan = plan_of(
            option_values.laws(law),
            quick=quick,
            networks=_names(network),
            instruments=_names(instrument),
            steadiness=_names(hand),
            settings=option_values.settings(settings or ()),
        )
        options = FigureOptions.of(formats, style)
        choice = {"--network": network, "--instrument": instrument, "--hand": hand}
        command = _command(law, choice, quick=quick, settings=settings or ())
        with sweep_in(out, workers, scheduler, shown=not as_json, kind=RUNS) as sweep:
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
        # networks that stand for no kind of line are shown by themselves
        head, table = (SITUATION_HEAD, situation_rows(situations)) if situations else (CHOICE_HEAD, choice_rows(rows))
        print_result(summary, head, table, out, as_json=as_json)
        if not as_json:
            typer.echo(f"digest: {summary['digest']}")


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _command(law: str, choice: dict[str, str], *, quick: bool, settings: list[str] | tuple[()]) -> str:
    """Return the command that makes this result, without where it is put."""
    words = ["telenano benchmark", *(["--quick"] if quick else []), *([f"--law {law}"] if law != "all" else [])]
    words += [f"{option} {names}" for option, names in choice.items() if names]
    return " ".join([*words, *(f"--set {setting}" for setting in settings)])

"""`telenano study drift`: the effect of a drift in z, constant or wandering, on each law."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.analysis import Page
from telenano.cli import JsonOption, law_names, report_errors, results_in
from telenano.settings import profile_named
from telenano.wire import ConfigError
from telenano_lab.studies import option_values
from telenano_lab.studies.study_options import WorkersOption
from telenano_lab.studies.study_results import INTERRUPTED, command_line, print_result, sweep_in, write_study

_HEAD = ("law", "drift", "speed [pm/s]", "time constant [s]", "stable", "felt/true", "least", "most", "parts [mm]",
         "most [mm]")  # fmt: skip


def drift(
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for page, table and journal; resumes a journal.")
    ],
    law: Annotated[
        str, typer.Option("--law", metavar="LAW[,LAW]|all", help="Laws to study.", autocompletion=law_names)
    ] = "all",
    network: Annotated[str, typer.Option("--network", metavar="NAME", help="The network between the sites.")] = "clean",
    speed: Annotated[
        str,
        typer.Option(
            "--speed", metavar="PM/S[,PM/S]", help="Speeds [pm/s]; for a wandering one, its root mean square."
        ),
    ] = "10,50",
    time_constant: Annotated[
        str,
        typer.Option("--time-constant", metavar="S[,S]", help="Correlation time of a speed that wanders [s]."),
    ] = "5,60",
    seeds: Annotated[int, typer.Option("--seeds", min=1, max=1000, help="Draws of each wander.")] = 4,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Press a spring and follow a swing while the base drifts in z: felt stiffness, and distance of hand and tip."""
    with report_errors(as_json, INTERRUPTED):
        from telenano_lab.experiments.drift_study import DRIFT_RUNS, rows_of, runs_of

        profile_named(network)
        speeds, times = _numbers("--speed", speed), _numbers("--time-constant", time_constant)
        with sweep_in(out, workers, None, shown=not as_json, kind=DRIFT_RUNS) as sweep:
            outcomes = sweep.run(runs_of(option_values.laws(law), network, speeds, times, seeds))
        found = rows_of(outcomes)
        summary = {"study": "drift", "network": network, "seeds": seeds, "rows": [row._asdict() for row in found]}
        rows = [
            (r.law, r.drift, r.speed_pm_per_s, r.wander_s, f"{r.stable}/{r.runs}", r.felt, r.felt_least, r.felt_most,
             r.parted_mm, r.parted_most_mm)
            for r in found
        ]  # fmt: skip
        page = Page("What the laws make of a drift in z")
        page.code(command_line())
        page.table(_HEAD, rows)
        page.paragraph(
            "A spring of 20 N/m is pressed with 1 N, held, and a swing of 0.3 N at 0.5 Hz followed. Felt: the stiffness"
            " at the hand in the swing, over the true one; parts: what hand and tip part by from the middle of the hold"
            " to the end. Of a drift that wanders the speed is the root mean square of a process of Ornstein and"
            " Uhlenbeck, whose draws give median, least and most."
        )
        with results_in(out) as folder:
            write_study(folder, page, summary)
        print_result(summary, _HEAD, rows, out, as_json=as_json)


def _numbers(option: str, text: str) -> list[float]:
    try:
        found = [float(part) for part in text.split(",") if part.strip()]
    except ValueError as error:
        raise ConfigError(f"{option} {text}: must be numbers with commas between them") from error
    if not found or not all(0.0 < each <= 1e6 for each in found):
        raise ConfigError(f"{option} {text}: must be numbers above 0, with commas between them")
    return found

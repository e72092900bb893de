"""`telenano study promises`: test the promises of the laws over bad links on drawn cells."""

from typing import Annotated

import typer

from telenano.analysis import Page
from telenano.cli import EXIT_FAILED, JsonOption, law_names, report_errors, results_in
from telenano_lab.studies import option_values
from telenano_lab.studies.loops.promises import as_dict, broken, outcomes
from telenano_lab.studies.study_options import OutOption, WorkersOption
from telenano_lab.studies.study_results import INTERRUPTED, command_line, print_result, sweep_in, write_study

_HEAD = ("law", "hand", "round trip [ms]", "energy >= -1 uJ", "least energy [uJ]", "stable", "force (median)",
         "force (least)", "hand ahead [mm]", "not stable")  # fmt: skip


def promises(
    out: OutOption,
    law: Annotated[
        str, typer.Option("--law", metavar="LAW[,LAW]|all", help="Laws to study.", autocompletion=law_names)
    ] = "passivity,wave",
    seeds: Annotated[int, typer.Option("--seeds", min=1, max=10_000, help="Seeds: six drawn cells each.")] = 50,
    burst: Annotated[
        float | None,
        typer.Option(
            "--burst", min=1.0, max=1e4, metavar="N", help="Lose 5, 20 or 50 %, N messages in a row on average."
        ),
    ] = None,
    uneven: Annotated[
        bool,
        typer.Option(
            "--uneven", help="Slots, outages that hold, bursts and delays in a sawtooth, instead of jitter and loss."
        ),
    ] = False,
    workers: WorkersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Try the promises of the laws on random bad links; exit code 1 if a law that promises passivity made energy."""
    with report_errors(as_json, INTERRUPTED):
        with sweep_in(out, workers, None, shown=not as_json) as sweep:
            judged = outcomes(option_values.laws(law), seeds, sweep, burst, uneven=uneven)
        failed = broken(judged)
        rows_found = [as_dict(row) for row in judged]
        summary = {"study": "promises", "seeds": seeds, "burst": burst, "uneven": uneven, "held": not failed}
        summary |= {"rows": rows_found}
        rows = [
            (r.law, r.hand, r.round_trip_ms, f"{r.passive}/{r.runs}", 1e6 * r.lowest_energy_j, f"{r.stable}/{r.runs}",
             r.share, r.least_share, None if r.apart_m is None else 1e3 * r.apart_m,
             ", ".join(f"{number} {kind.replace('_', ' ')}" for kind, number in r.failed.items()))
            for r in judged
        ]  # fmt: skip
        lost = "0, 5 or 20 % loss" if burst is None else f"5, 20 or 50 % loss, {burst:g} messages in a row on average"
        link = f"Jitter of half the delay, {lost}"
        if uneven:
            link = "Slots, outages that hold, bursts or delays in a sawtooth both ways"
        page = Page("What the laws promise over bad links")
        page.code(command_line())
        page.table(_HEAD, rows)
        page.paragraph(
            f"{link}, springs of 5 to 200 N/m and the contact, drawn at random;"
            " force: at the tip, as a share of what the hand means to press with, in stable holds."
        )
        with results_in(out) as folder:
            write_study(folder, page, summary)
        print_result(summary, _HEAD, rows, out, as_json=as_json)
    if failed:
        raise typer.Exit(EXIT_FAILED)

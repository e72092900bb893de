"""`telenano study advise`: recommend a law for a line, a sample and an instrument."""

from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.analysis import Page
from telenano.cli import JsonOption, TableOption, report_errors, results_in, table_formats, validated, with_options
from telenano_lab.studies.loops.advice import Question
from telenano_lab.studies.study_options import WorkersOption
from telenano_lab.studies.study_results import INTERRUPTED, command_line, print_result, sweep_in, write_study

_OVER_SEEDS = "Over the seeds of a random link: mean ± standard deviation and, in brackets, the interval of 95 %."


@with_options(Question)
def advise(
    given: dict[str, Any],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Folder for page, table and journal; resumes a journal.")
    ] = Path("out/advice"),
    workers: WorkersOption = None,
    table: TableOption = "parquet",
    as_json: JsonOption = False,
) -> None:
    """Advise a law for a network and a sample, by the benchmark's cells and a trial on the line itself."""
    with report_errors(as_json, INTERRUPTED):
        from telenano_lab.experiments.benchmark import line_advice

        question, tables = validated(Question, given), table_formats(table)
        with sweep_in(out, workers, None, shown=not as_json) as sweep:
            advice = line_advice.advise(question, sweep)
        words, records, candidates = line_advice.in_words(advice), advice.as_records(), advice.ordered
        summary = {"study": "advise", "take": records[0]["law"] if records[0]["suited"] else None, "advice": words,
                   "cells": advice.situation._asdict(), "benchmark": advice.digest,
                   "candidates": records}  # fmt: skip
        over_seeds = [candidate.over_seeds() for candidate in candidates]
        repeated = ("force over seeds", "peak over seeds") if over_seeds[0] else ()
        head = ("law", "stable runs", "held in the benchmark", "force in a hold", "peak force", "felt stiffness",
                "hand and tip apart", "free [N s/m]",
                "least energy [mJ]", "price", *repeated)  # fmt: skip
        rows = [
            (c.name, f"{r['stable_runs']}/{r['runs']}", _of_benchmark(r), r["force_share"], r["peak_share"],
             r["felt_share"], r["apart_share"], r["free_n_s_per_m"], 1e3 * r["lowest_energy_j"], r["price"],
             *([str(o["force_share"]), str(o["peak_share"])] if o else []))
            for c, r, o in zip(candidates, records, over_seeds, strict=True)
        ]  # fmt: skip
        page = Page("Which law to take")
        page.code(command_line())
        for sentence in words:
            page.paragraph(sentence)
        page.table(head, rows)
        page.paragraph(
            "Held in the benchmark: runs of its cells that were held, of all of them; its runs.csv has the digest"
            f" {advice.digest}."
        )
        if repeated:
            page.paragraph(_OVER_SEEDS)
        with results_in(out) as folder:
            write_study(folder, page, summary, tables, advise=records)
        if not as_json:
            for sentence in [*words, *([_OVER_SEEDS] if repeated else [])]:
                typer.echo(sentence)
            typer.echo(f"set: {candidates[0].as_flags()}")
        print_result(summary, head, rows, out, as_json=as_json)


def _of_benchmark(record: dict[str, Any]) -> str | None:
    found = record["benchmark"]
    return None if found is None else f"{found['held']}/{found['runs']}"

"""Helpers shared by the studies: the sweep with its progress, the files of a result, and its output."""

import contextlib
import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import typer

from telenano.analysis import Page, cell_text
from telenano.cli import print_json, print_rows, progress, results_in, say
from telenano_lab.studies.image_files import write_tables
from telenano_lab.studies.loops.sweep import HOLDS, JOURNAL_NAME, Journal, Kind, Sweep

INTERRUPTED = "interrupted: the journal keeps the finished cells, the same command continues"
NO_JOURNAL = "interrupted: this study keeps no journal, the same command begins again"


@contextlib.contextmanager
def sweep_in(
    out: Path, workers: int | None, scheduler: str | None, *, shown: bool, kind: Kind = HOLDS
) -> Iterator[Sweep]:
    """Yield a sweep with the journal of a folder, and show its progress on stderr."""
    with results_in(out, at_once=True), progress("cells", shown=shown, counted=True) as show:
        yield Sweep(
            Journal(out / JOURNAL_NAME, kind),
            workers,
            scheduler,
            show,
            warn_of,
        )


def warn_of(*doubts: str) -> None:
    """Print the doubts about the result of a study."""
    for doubt in doubts:
        say(f"warning: {doubt}")


def command_line() -> str:
    """Return the command that made the page."""
    return " ".join(["telenano", *(() if sys.argv[1:2] == ["study"] else ("study",)), *sys.argv[1:]])


def write_study(
    folder: Path,
    page: Page,
    summary: dict[str, Any],
    formats: Sequence[str] = ("parquet",),
    **tables: list[dict[str, Any]],
) -> None:
    """Write page, summary and tables of a study into a folder; page and summary are named after the study."""
    document = json.dumps(summary, indent=2) + "\n"
    (folder / f"{summary['study']}.json").write_text(document, encoding="utf-8")
    page.write(folder / f"{summary['study']}.html")
    for name, rows in tables.items():
        write_tables(folder, name, rows, formats)


def print_result(
    summary: dict[str, Any], head: tuple[str, ...], rows: list[tuple[Any, ...]], folder: Path, *, as_json: bool
) -> None:
    """Print the result of a study as JSON, or as a table with the path of its page."""
    if as_json:
        print_json(summary)
        return
    if rows:
        print_rows([dict(zip(head, map(cell_text, row), strict=True)) for row in rows])
    typer.echo(f"page: {folder / summary['study']}.html")

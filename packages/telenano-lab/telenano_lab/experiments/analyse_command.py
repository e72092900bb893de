"""`telenano experiment analyse`: the table of an experiment, its tests, effect sizes and figures, on one page."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli import (
    FormatOption,
    JsonOption,
    StyleOption,
    print_json,
    print_rows,
    report_errors,
    results_in,
    say,
)

FOLDER = "analysis"
# Longer tables are not printed.
_MOST_ROWS = 40


def analyse(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the experiment, with its journal.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder for tables, figures and page; default: FOLDER/analysis."),
    ] = None,
    measure: Annotated[
        list[str] | None,
        typer.Option("--measure", metavar="NAME", help="Measure to analyse (repeatable); default: all."),
    ] = None,
    category: Annotated[
        list[str] | None,
        typer.Option("--category", metavar="FACTOR", help="Numeric factor to treat as categories (repeatable)."),
    ] = None,
    within: Annotated[
        str, typer.Option("--within", metavar="FACTOR", help="Compare levels of the others at each level of this one.")
    ] = "",
    correction: Annotated[
        str,
        typer.Option(
            "--correction", metavar="holm|bonferroni|fdr_bh|none", help="Correction for multiple comparisons."
        ),
    ] = "holm",
    confidence: Annotated[
        float, typer.Option("--confidence", min=0.5, max=0.999, metavar="P", help="Confidence of all intervals.")
    ] = 0.95,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    as_json: JsonOption = False,
) -> None:
    """Make the tidy table of an experiment and analyse it: descriptions, tests, effect sizes, thresholds, figures.

    The trials that count are those of the main phase that were done, of participants who are not excluded. The command
    may be given while an experiment continues, and as often as one likes: everything is made from the journal again.
    """
    with report_errors(as_json):
        from telenano.analysis import FigureOptions
        from telenano_lab.experiments.analyse import Choice, analyse, check_choice
        from telenano_lab.experiments.analysis_page import NAME, write_analysis
        from telenano_lab.experiments.folder_tables import about_experiment, adaptive_factors, tables_of
        from telenano_lab.experiments.table import write_tables

        options = FigureOptions.of(formats, style)
        tables = tables_of(folder)
        choice = Choice(tuple(measure or ()), correction, confidence, tuple(category or ()), within)
        check_choice(tables, choice)
        target = out or folder / FOLDER
        # The table of trials is written even if the analysis fails.
        with results_in(target) as part:
            write_tables(tables, part)
        analysis = analyse(tables, choice, adaptive_factors(folder))
        command = " ".join(["telenano", *sys.argv[1:]])
        with results_in(target) as part:
            document = write_analysis(part, analysis, tables, about_experiment(folder), command, options)
        if as_json:
            print_json(document)
        else:
            _print(document, target / f"{NAME}.html")


def _print(document: dict[str, Any], page: Path) -> None:
    from telenano.analysis import cell_text

    columns = {
        "terms": ("measure", "term", "f", "df1", "df2", "p_corrected", "partial_eta2"),
        "slopes": ("measure", "factor", "slope", "low", "high", "p"),
        "pairs": ("measure", "at", "factor", "level", "against", "difference", "low", "high", "p_corrected", "g"),
        "thresholds": ("participant", *_varied(document), "factor", "threshold", "low", "high", "trials"),
        "detections": ("participant", *_varied(document), "d_prime", "d_prime_low", "d_prime_high", "criterion"),
    }
    for part, names in columns.items():
        rows = document[part]
        if len(rows) > _MOST_ROWS:
            typer.echo(f"{part}: {len(rows)} rows, which are on the page")
        elif rows:
            shown = [{name.replace("_", " "): cell_text(row.get(name)) for name in names} for row in rows]
            print_rows(shown, title=part)
    for row in document["models"]:
        for remark in row["remarks"]:
            say(f"{row['task']}, {row['measure']}: {remark}")
    for row in document["thresholds"]:
        if row["note"]:
            say(f"{row['task']}, {row['participant']}: {row['factor']}: {row['note']}")
    typer.echo(document["methods"])
    typer.echo(f"page: {page}")


def _varied(document: dict[str, Any]) -> list[str]:
    """Return the names of the factors other than the adaptive one."""
    return list(dict.fromkeys(factor["name"] for factors in document["factors"].values() for factor in factors))

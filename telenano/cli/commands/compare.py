"""`telenano compare`: several sessions in one figure and one table."""

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from proto.errors import ConfigError, ReportError
from services.viz_node.figure_style import FigureOptions, figure_options
from telenano.cli.options import FormatOption, JsonOption, StyleOption
from telenano.cli.output import print_json, print_rows, report_errors


def compare(
    sessions: Annotated[
        list[Path], typer.Argument(metavar="SESSION", help="Recordings (.mcap), or folders of `up --out`.")
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for compare.png, compare.csv and compare.json.")
    ] = Path("compare"),
    paper: Annotated[
        bool,
        typer.Option("--paper", help="Draw what the paper says of its Fig. 12 beneath; one session is enough then."),
    ] = False,
    published: Annotated[
        list[Path] | None,
        typer.Option(
            "--published", metavar="FILE", help="Draw the points of a published curve beneath (CSV, repeatable)."
        ),
    ] = None,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    as_json: JsonOption = False,
) -> None:
    """Draw sessions over one another, and put their figures into one table."""
    with report_errors(as_json):
        if len(sessions) < 2 and not paper and not published:
            raise ConfigError("compare: give two sessions or more, or one with --paper or --published")
        rows = compare_sessions(sessions, out, figure_options(formats, style), published or (), paper=paper)
    print_comparison(rows, out, as_json=as_json)


def compare_sessions(
    sessions: list[Path], out: Path, options: FigureOptions, published: Sequence[Path] = (), *, paper: bool = False
) -> list[dict[str, Any]]:
    """Write figure and tables of sessions into a folder; return the rows of the table.

    Published points are drawn beneath, and stand in `published.json` with the nearest of each session.
    """
    # The import brings matplotlib, which takes a second.
    from analysis.compare import beside, compare_figure, rows_of
    from analysis.compare import compare as read
    from analysis.conditions import described
    from analysis.published import paper_points, read_published
    from analysis.report import write_files
    from services.viz_node.figure_style import drawn

    points = [*([paper_points()] if paper else []), *map(read_published, published)]
    found = read(sessions)
    rows = rows_of(found)
    table = io.StringIO()
    writer = csv.DictWriter(table, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    summaries = {session.name: session.summary for session in found}
    origin = "\n".join(f"{name}: {described(summary['scenario'], summary)}" for name, _, summary in found)
    files = drawn(compare_figure(found, options, points), "compare", options, origin)
    files["compare.csv"] = table.getvalue().encode()
    files["compare.json"] = _json(summaries)
    if points:
        files["published.json"] = _json([beside(found, part) for part in points])
    try:
        write_files(out, files)
    except OSError as error:
        raise ReportError(f"{error.filename}: cannot be written: {error.strerror}", {}) from error
    return rows


def _json(document: Any) -> bytes:
    return (json.dumps(document, indent=2) + "\n").encode()


def print_comparison(rows: list[dict[str, Any]], out: Path, *, as_json: bool) -> None:
    """Print the table: a row a session as JSON, or a column a session, which a terminal has room for."""
    if as_json:
        print_json({"sessions": rows, "folder": str(out)})
        return
    keys = [key for key in rows[0] if key != "session"]
    print_rows([{"": key, **{row["session"]: row[key] for row in rows}} for key in keys])
    typer.echo(f"figure and tables: {out}")

"""`telenano compare`: several sessions in one figure and one table."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from telenano.analysis import FigureOptions
from telenano.cli import (
    FormatOption,
    JobsOption,
    JsonOption,
    SameSessionOption,
    StyleOption,
    TableOption,
    print_json,
    print_rows,
    report_errors,
    results_in,
    table_formats,
)
from telenano.wire import ConfigError
from telenano_lab.studies.repetitions import CONFIDENCE, statistics_of


def compare(
    sessions: Annotated[
        list[Path], typer.Argument(metavar="SESSION", help="Recordings (.mcap), or folders of `up --out`.")
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", metavar="DIR", help="Folder for compare.png, compare.csv and compare.json.")
    ] = Path("out/compare"),
    paper: Annotated[
        bool,
        typer.Option("--paper", help="Draw the paper's values of its Fig. 12 beneath; one session is enough then."),
    ] = False,
    published: Annotated[
        list[Path] | None,
        typer.Option(
            "--published", metavar="FILE", help="Draw the points of a published curve beneath (CSV, repeatable)."
        ),
    ] = None,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    table: TableOption = "csv",
    jobs: JobsOption = None,
    same_session: SameSessionOption = False,
    as_json: JsonOption = False,
) -> None:
    """Draw sessions beside one another, and put their figures into one table; with statistics where seeds differ."""
    with report_errors(as_json):
        from telenano_lab.studies.comparison import sessions_in

        sessions = sessions_in(sessions)
        if len(sessions) < 2 and not paper and not published:
            raise ConfigError("compare: give two sessions or more, or one with --paper or --published")
        comparison = compare_sessions(
            sessions,
            out,
            FigureOptions.of(formats, style),
            published or (),
            paper=paper,
            tables=table,
            same_session=same_session,
            jobs=jobs,
        )
    print_comparison(comparison, out, as_json=as_json)


class Comparison(NamedTuple):
    """The rows of the sessions, and the statistics of repetitions; none where nothing was repeated."""

    sessions: list[dict[str, Any]]
    statistics: list[dict[str, Any]]


def compare_sessions(
    sessions: list[Path],
    out: Path,
    options: FigureOptions,
    published: Sequence[Path] = (),
    *,
    paper: bool = False,
    tables: str = "csv",
    same_session: bool = False,
    jobs: int | None = None,
) -> Comparison:
    """Write figure and tables of sessions into a folder; return the rows of the tables.

    Published points are drawn beneath the curves; `published.json` has each with the nearest point of each session.
    """
    # Imported here, because matplotlib takes a second to import.
    from telenano_lab.studies.comparison import beside, compare_figures, rows_of
    from telenano_lab.studies.comparison import compare as read
    from telenano_lab.studies.published import paper_points, read_published
    from telenano_lab.studies.table_files import table_files

    kinds = table_formats(tables)
    points = [*([paper_points()] if paper else []), *map(read_published, published)]
    comparison = read(sessions, same_session=same_session, jobs=jobs)
    rows = rows_of(comparison)
    statistics = statistics_of(rows, [session.scenario for session in comparison])
    summaries = {session.name: session.summary for session in comparison}
    origin = "\n".join(f"{row.name}: {row.session.origin}" for row in comparison)
    files: dict[str, bytes] = {}
    for number, figure in enumerate(compare_figures(comparison, options, points), start=1):
        files |= options.drawn(figure, "compare" if number == 1 else f"compare_{number}", origin)
    files |= table_files("compare", rows, kinds)
    files |= table_files("statistics", statistics, kinds) if statistics else {}
    files["compare.json"] = _json(summaries)
    if points:
        files["published.json"] = _json([beside(comparison, part) for part in points])
    with results_in(out) as folder:
        for name, content in files.items():
            (folder / name).write_bytes(content)
    return Comparison(rows, statistics)


def _json(document: Any) -> bytes:
    return (json.dumps(document, indent=2) + "\n").encode()


def print_comparison(comparison: Comparison, out: Path, *, as_json: bool) -> None:
    """Print the tables: as JSON with a row for each session, else with a column for each, which fits a terminal."""
    if as_json:
        repeated = {"statistics": comparison.statistics} if comparison.statistics else {}
        print_json({"sessions": comparison.sessions, **repeated, "folder": str(out)})
        return
    if not comparison.statistics:
        keys = [key for key in comparison.sessions[0] if key != "session"]
        print_rows([{"": key, **{row["session"]: row[key] for row in comparison.sessions}} for key in keys])
    else:
        print_rows([{key: _rounded(value) for key, value in row.items()} for row in comparison.statistics])
        typer.echo(f"low and high: interval of the mean, or of the share, with {100.0 * CONFIDENCE:g} % confidence")
    typer.echo(f"figure and tables: {out}")


def _rounded(value: Any) -> Any:
    return float(f"{value:.5g}") if isinstance(value, float) else value

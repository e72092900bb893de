"""`telenano budget`: the uncertainty of a session's figures by source, and the delay of its loop by stage."""

from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli import JsonOption, SameSessionOption, print_json, report_errors

_WITHOUT = (
    "A simulated device has no calibration. Of a real one give the files that were in use with --handle and --stage; "
    "what they state no standard error of is left out:"
)


def budget(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="The master's recording of one session, in its parts.")
    ],
    handle: Annotated[
        Path | None, typer.Option("--handle", metavar="FILE", help="handle.yaml, as it was in use.")
    ] = None,
    stage: Annotated[Path | None, typer.Option("--stage", metavar="FILE", help="stage.yaml, as it was in use.")] = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Folder for the page and budget.json.")
    ] = None,
    same_session: SameSessionOption = False,
    as_json: JsonOption = False,
) -> None:
    """State the error of a session's figures by its sources, and the delay of the loop by its stages."""
    with report_errors(as_json):
        import json

        from telenano.analysis import Session, summary_of
        from telenano.cli import results_in
        from telenano.devices import HandleCalibration, InstrumentCalibration
        from telenano.recording import open_recordings
        from telenano_lab.calibration.budget import delay_budget, figure_budgets, scale_errors

        shares = scale_errors(
            None if handle is None else HandleCalibration.from_file(handle),
            None if stage is None else InstrumentCalibration.from_file(stage),
        )
        recording = open_recordings(recordings, same_session=same_session)
        session = Session.of(recording)
        summary = summary_of(session, recording)
        figures = figure_budgets(summary, shares)
        stages = delay_budget(recording, session)
        document: dict[str, Any] = {
            "verdict": summary["verdict"],
            "link_round_trip_ms": summary.get("link_round_trip_ms"),
            "figures": [{**one._asdict(), "sources": [part._asdict() for part in one.sources]} for one in figures],
            "delay": [one._asdict() for one in stages],
        }
        if out is not None:
            with results_in(out) as folder:
                text = json.dumps(document, indent=2, allow_nan=False) + "\n"
                (folder / "budget.json").write_text(text, encoding="utf-8")
                _page(figures, stages, document).write(folder / "budget.html")
    if as_json:
        print_json(document)
        return
    _show(figures, stages, document)
    if out is not None:
        typer.echo(f"{out}: budget.html, budget.json")


def _tables(figures: Any, stages: Any) -> list[tuple[str, list[dict[str, str]]]]:
    from telenano_lab.calibration.budget import delay_rows, force_rows

    return [("Figures", list(force_rows(figures))), ("Delay of the loop", list(delay_rows(stages)))]


def _sentences(figures: Any, document: dict[str, Any]) -> list[str]:
    trip_ms = document["link_round_trip_ms"]
    sentences = [] if trip_ms is None else [f"The link adds a delay of {trip_ms:g} ms there and back, as set."]
    without = dict.fromkeys(scale for one in figures for scale in one.without)
    return [*sentences, *([f"{_WITHOUT} {', '.join(without)}."] if without else [])]


def _show(figures: Any, stages: Any, document: dict[str, Any]) -> None:
    from telenano.cli import print_rows

    for _, rows in _tables(figures, stages):
        if rows:
            print_rows(rows)
    for sentence in _sentences(figures, document):
        typer.echo(sentence)


def _page(figures: Any, stages: Any, document: dict[str, Any]) -> Any:
    from telenano.analysis import Page

    page = Page("Budget of a session")
    for heading, rows in _tables(figures, stages):
        page.heading(heading)
        if rows:
            page.table(list(rows[0]), [list(row.values()) for row in rows])
        else:
            page.paragraph("No figure of the session has an interval, because no hold was judged.")
    for sentence in _sentences(figures, document):
        page.paragraph(sentence)
    return page

"""`telenano bag diff`: compare two recordings message by message."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.cli import ExcludeOption, JsonOption, TopicsOption, print_json, report_errors

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="Recording (.mcap).")]


def diff(
    left: FileArgument,
    right: FileArgument,
    topics: TopicsOption = None,
    exclude: ExcludeOption = None,
    tolerance: Annotated[
        list[str] | None,
        typer.Option(
            "--tolerance", metavar="[TOPIC:]FIELD=VALUE", help="Largest difference, in the field's unit (repeatable)."
        ),
    ] = None,
    ignore: Annotated[
        list[str] | None, typer.Option("--ignore", metavar="FIELD", help="Not this field, such as t_ns (repeatable).")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare two recordings message by message, by channel and number; exit code 1 if they differ."""
    from telenano.cli import EXIT_FAILED, print_rows

    with report_errors(as_json):
        from telenano.recording import Selection, Tolerances
        from telenano_lab.studies.recording_diff import diff_recordings

        allowed = Tolerances.parse(tolerance or ())
        chosen = Selection.of(topics or (), exclude or ())
        difference = diff_recordings(left, right, allowed, ignore or (), chosen)
    if as_json:
        print_json(difference.model_dump(mode="json"))
    else:
        rows = [row.model_dump() for row in difference.channels if row.only_left or row.only_right or row.different]
        typer.echo("the same" if difference.same else f"{left} and {right} differ")
        if rows:
            print_rows(rows)
    if not difference.same:
        raise typer.Exit(EXIT_FAILED)

"""`telenano report`: write figure and summary of a recording again."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.analysis.figure_style import FigureOptions
from telenano.analysis.report import write_report
from telenano.cli.options import FormatOption, JsonOption, StyleOption
from telenano.cli.output import fail_with_summary, print_summary, report_errors
from telenano.wire.errors import ReportError


def report(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="Recording (.mcap), or the parts of one.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for fig12.png and summary.json.")],
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    as_json: JsonOption = False,
) -> None:
    """Write figure and summary of a recording again, and print it; exit code 3 if something is missing in it."""
    with report_errors(as_json):
        try:
            summary = write_report(files, out, options=FigureOptions.of(formats, style))
        except ReportError as error:
            fail_with_summary(error, str(out), as_json=as_json)
    print_summary(summary, str(out), tables=True, as_json=as_json)

"""`telenano report`: write figure and summary of a recording again."""

from pathlib import Path
from typing import Annotated

import typer

from analysis.report import write_report
from telenano.options import JsonOption
from telenano.output import print_document, report_errors


def report(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording (.mcap).")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for fig12.png and summary.json.")],
    as_json: JsonOption = False,
) -> None:
    """Write figure and summary of a recording again."""
    with report_errors(as_json):
        summary = write_report(file, out)
    print_document(summary, str(out), as_json=as_json)

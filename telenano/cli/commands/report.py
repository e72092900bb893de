"""`telenano report`: write figure and summary of a recording again."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.analysis.figure_style import FigureOptions
from telenano.analysis.report import write_report
from telenano.cli.options import FormatOption, JsonOption, SameSessionOption, StyleOption
from telenano.cli.output import fail_with_summary, print_summary, report_errors
from telenano.recording.multi_file import recordings_of
from telenano.wire.errors import ConfigError, ReportError


def report(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE|DIR", help="Recording (.mcap), or the parts of one, or the folder of a session."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Folder for fig12.png and summary.json; default: the folder that was given."
        ),
    ] = None,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    same_session: SameSessionOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write figure and summary of a recording again, and print it; exit code 3 if something is missing in it."""
    with report_errors(as_json):
        folders = [path for path in files if path.is_dir()]
        if out is None and len(folders) != 1:
            raise ConfigError("--out: is needed, unless the folder of one session is given, where the report then goes")
        out = out or folders[0]
        files = [file for path in files for file in recordings_of(path)]
        try:
            summary = write_report(files, out, options=FigureOptions.of(formats, style), same_session=same_session)
        except ReportError as error:
            fail_with_summary(error, str(out), as_json=as_json)
    print_summary(summary, str(out), tables=True, as_json=as_json)

"""`telenano report`: write figure and summary of a recording again."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.analysis.figure_style import FigureOptions
from telenano.analysis.report import write_report
from telenano.cli.options import FormatOption, JsonOption, SameSessionOption, StyleOption
from telenano.cli.output import fail_with_summary, print_summary, report_errors
from telenano.recording.multi_file import recordings_of
from telenano.wire.errors import ConfigError, NoRecordingError, ReportError


def report(
    files: Annotated[
        list[Path],
        typer.Argument(metavar="FILE|DIR", help="Recording (.mcap), or the parts of one, or the folder of a session."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Folder for fig12.png and summary.json; default: that of the session."
        ),
    ] = None,
    formats: FormatOption = "png",
    style: StyleOption = "screen",
    same_session: SameSessionOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write figure and summary of a recording again, and print it; exit code 3 if something is missing in it."""
    with report_errors(as_json):
        out = out or _own_folder(files)
        files = [file for path in files for file in recordings_of(path)]
        try:
            summary = write_report(files, out, options=FigureOptions.of(formats, style), same_session=same_session)
        except ReportError as error:
            fail_with_summary(error, str(out), as_json=as_json)
    print_summary(summary, str(out), tables=True, as_json=as_json)


def _own_folder(paths: list[Path]) -> Path:
    """Return the folder of the session that is given by its folder or its files; ConfigError if there is not one."""
    for path in paths:
        if not path.exists():
            raise NoRecordingError(f"{path}: cannot be read: No such file or directory")
    folders = {path if path.is_dir() else path.parent for path in paths}
    if len(folders) == 1 and (all(path.is_dir() for path in paths) or (min(folders) / "summary.json").is_file()):
        return folders.pop()
    raise ConfigError(
        "--out: is needed, unless one session is given, by its folder or by its files beside their summary.json, where"
        " the report then goes"
    )

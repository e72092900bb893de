"""`telenano report`: write figure and summary of a recording again."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from telenano.analysis.figure_style import FigureOptions
from telenano.analysis.report import write_report
from telenano.cli.option_rules import Void, rules
from telenano.cli.options import FormatOption, JobsOption, JsonOption, SameSessionOption, StyleOption
from telenano.cli.output import fail_incomplete, fail_with_summary, print_answer, print_summary, report_errors
from telenano.cli.sweep import run_children
from telenano.recording.session_folder import recordings_of
from telenano.wire.errors import ConfigError, NoRecordingError, ReportError


@rules(Void("--jobs", "which is one session", beside="--out, --same-session"))
def report(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE|DIR",
            help="Recording (.mcap), or the parts of one, or the folder of a session, of several or of a sweep.",
        ),
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
    jobs: JobsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write figure and summary of a recording again, and print it; exit code 3 if something is missing in it.

    Several folders without --out are a session each, and so are those in a folder that has no recording itself; each
    gets its own report.
    """
    with report_errors(as_json):
        folders = [] if out or same_session else _folders_of(files)
        if folders:
            _report_each(folders, formats, style, jobs, as_json=as_json)
            return
        out = out or _own_folder(files)
        files = [file for path in files for file in recordings_of(path)]
        try:
            summary = write_report(files, out, options=FigureOptions.of(formats, style), same_session=same_session)
        except ReportError as error:
            fail_with_summary(error, str(out), as_json=as_json)
    print_summary(summary, str(out), tables=True, as_json=as_json)


def _folders_of(paths: Sequence[Path]) -> list[Path]:
    """Return the folders of the sessions that paths name, if they name several and nothing else; otherwise none."""
    # A pattern such as `out/sweep/*` matches the table and the figure of a sweep too.
    several = any(path.is_dir() for path in paths)
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(each.parent for each in path.glob("*/session.mcap"))
            found += [path] if any(path.glob("session*.mcap")) else inside
        elif path.suffix == ".mcap" or not path.exists() or not several:
            return []
    return found if len(found) > 1 or found != list(paths) else []


def _report_each(folders: Sequence[Path], formats: str, style: str, jobs: int | None, *, as_json: bool) -> None:
    """Write the report of each session, by a command of its own, and print a row for each."""
    own = ["--format", formats, "--style", style, "--json"]
    commands = {str(folder): [sys.executable, "-m", "telenano", "report", str(folder), *own] for folder in folders}
    summaries = run_children(commands, jobs, what="report", quiet=as_json)
    rows = [
        {
            "session": name,
            **{key: summaries[name][key] for key in ("verdict", "law", "link_round_trip_ms", "hold_ratio")},
        }
        for name in commands
    ]
    print_answer({"sessions": [summaries[name] for name in commands]}, rows, as_json=as_json)
    missing = [f"{name}: {text}" for name in commands for text in summaries[name]["recording"]["missing"]]
    if missing:
        fail_incomplete(missing)


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

"""Report of a session, a figure and a summary, from its recording alone."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from telenano.analysis.conditions import title
from telenano.analysis.fig12 import fig12_files
from telenano.analysis.figure_style import ON_SCREEN, FigureOptions
from telenano.analysis.intervals import with_error
from telenano.analysis.recorded_session import Session
from telenano.analysis.session_judge import summary_of
from telenano.files.atomic_files import whole_results
from telenano.recording.multi_file import open_recordings
from telenano.wire import extras
from telenano.wire.errors import ReportError


def write_report(
    path: Path | Sequence[Path],
    out: Path,
    missing: Sequence[str] = (),
    options: FigureOptions = ON_SCREEN,
    show: Callable[[str], None] = lambda text: None,
    *,
    same_session: bool = False,
) -> dict[str, Any]:
    """Write `fig12.png` and `summary.json` of a recording, or of the parts of one, to a folder.

    Args:
        path: The recording, or the parts of one.
        out: The folder of the report.
        missing: Sentences on missing data that the recording itself does not show.
        options: The formats and the style of the figure.
        show: Called with the name of each step; a step takes seconds for a recording of minutes.
        same_session: Whether to join files that are not recorded to be of one session.

    Returns:
        The summary.

    Raises:
        RecordingError: A file is incomplete, or two are not of one session; the message names them.
        ReportError: A file cannot be written, and no partial file is left; or the figure needs a package that is not
            installed, and the summary is written without it. The error has the summary.
    """
    paths = [path] if isinstance(path, Path) else path
    recording = open_recordings(paths, same_session=same_session)
    show("1 of 3: reading the session")
    session = Session.of(recording)
    show(f"2 of 3: reading all messages of its {session.duration_s:.0f} s, and judging")
    summary = summary_of(session, recording, missing)
    show("3 of 3: drawing the figure")
    # A stalled node leaves a gap as well, although the recording is complete.
    gaps_s = () if summary["recording"]["complete"] else session.gaps_s()
    text = json.dumps(summary, indent=2, allow_nan=False) + "\n"
    figures: dict[str, bytes] = {}
    undrawn = ""
    try:
        figures = fig12_files(session.series(gaps_s), figure_title(session, summary), options, session.origin)
    except ModuleNotFoundError as error:
        undrawn = f"{out / 'summary.json'} is written, and no figure is drawn: {extras.missing(error.name or '')}"
    write_files(out, {**figures, "summary.json": text.encode()}, summary)
    if undrawn:
        raise ReportError(undrawn, summary)
    return summary


def write_files(folder: Path, files: Mapping[str, bytes], summary: Mapping[str, Any] | None = None) -> None:
    """Write all files to a folder, or none of them.

    Raises:
        ReportError: One cannot be written; the message names it, and the error has the summary.
    """
    try:
        with whole_results(folder) as part:
            for name, data in files.items():
                # The error of a full disk does not name the file.
                try:
                    (part / name).write_bytes(data)
                except OSError as error:
                    raise OSError(error.errno, error.strerror, str(folder / name)) from error
    except OSError as error:
        raise ReportError(f"{error.filename}: cannot be written: {error.strerror}", dict(summary or {})) from error


def figure_title(session: Session, summary: Mapping[str, Any]) -> str:
    """Return the title of a session's figure: conditions, verdict, and a note if something is missing."""
    # The verdict is named, because an unstable session need not oscillate: it may drift, or press with another force.
    verdict = summary["verdict"].replace("_", " ")
    ratio = summary["hold_ratio"]
    error = summary.get("intervals", {}).get("hold_ratio")
    # The ratio of one hold does not describe a session whose verdict another hold decides.
    is_held = ratio is not None and summary["verdict"] == "stable"
    hold = f", hold ratio {with_error(ratio, error)}" if is_held else ""
    # A figure is passed on without its summary, so it must state that data are missing.
    whole = "" if summary["recording"]["complete"] else "\nthe recording is not whole: what is missing is grey"
    return f"{session.scenario}, {title(session.conditions)}: {verdict}{hold}{whole}"

"""`telenano bag`: the commands on recordings.

Each command imports its dependencies when it runs: the summary of an hour takes less time than all the imports.
"""

from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from pydantic import BaseModel

from telenano.cli.completion import node_names
from telenano.cli.exit_codes import EXIT_FAILED
from telenano.cli.options import (
    CountOption,
    EndOption,
    ExcludeOption,
    JsonOption,
    SameSessionOption,
    StartOption,
    TopicsOption,
    command_group,
)
from telenano.cli.output import print_answer, print_document, print_json, report_errors
from telenano.recording.channel_filter import Selection
from telenano.wire.errors import ConfigError, RecordingError

if TYPE_CHECKING:
    pass

_CHANNEL_COLUMNS = ("channel_topic", "src", "messages", "rate_hz", "gaps", "lost", "restarts")
# Recordings shorter than this are read as a whole, in a second or two.
_LONG_BYTES = 16 << 20

app = command_group()


def _file(path: Path) -> Path:
    """Return the recording that a path names: itself, or the one of a session's folder; ConfigError for several."""
    parts = _files([path])
    if len(parts) > 1:
        raise ConfigError(f"{path}: has several recordings, give one of {', '.join(part.name for part in parts)}")
    return parts[0]


def _files(paths: list[Path]) -> list[Path]:
    """Return the recordings that paths name: themselves, or all parts of the recording of a session's folder."""
    from telenano.recording.session_folder import recordings_of

    return [part for path in paths for part in recordings_of(path)]


FileArgument = Annotated[Path, typer.Argument(metavar="FILE|DIR", callback=_file, help="Recording, or its folder.")]
FilesArgument = Annotated[
    list[Path], typer.Argument(metavar="FILE|DIR", callback=_files, help="Recordings, or the folder of a session.")
]
OutOption = Annotated[Path, typer.Option("--out", metavar="PATH", help="File or folder to make, never overwritten.")]
NodesOption = Annotated[
    list[str] | None, typer.Option("--nodes", metavar="NODE", help="Only messages of these nodes (repeatable).")
]
ToleranceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--tolerance", metavar="[TOPIC:]FIELD=VALUE", help="Largest difference, in the field's unit (repeatable)."
    ),
]


@app.command()
def info(
    file: FileArgument,
    full: Annotated[bool, typer.Option("--full", help="Read every message, also of a long recording.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show the contents of a recording; those of a long one that was closed are read from its index."""
    with report_errors(as_json):
        summary = _read(file, full=full)
    if not as_json:
        # A table of all columns is wider and longer than a screen.
        summary["channels"] = [{key: row[key] for key in _CHANNEL_COLUMNS} for row in summary["channels"]]
        summary["metadata"] = summary["metadata"].get("recording", {})
    print_document(summary, str(file), as_json=as_json)


def _is_long(file: Path) -> bool:
    try:
        return file.stat().st_size >= _LONG_BYTES
    except OSError:
        # The function that reads the file reports the error.
        return False


def _read(file: Path, *, full: bool) -> dict[str, Any]:
    """Return the summary of a recording; of a long one from its index, where the index suffices."""
    from telenano.recording.summary_section import quick_info_with_people

    quick = quick_info_with_people(file) if _is_long(file) and not full else None
    if quick is None:
        from telenano.recording.people import people_in
        from telenano.recording.reader import Recording

        recording = Recording(file)
        quick = recording.info(), people_in(recording)
    info, people = quick
    return {**info.model_dump(mode="json"), "people": people}


@app.command("list")
def list_files(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder to search, with all its subfolders.")
    ] = Path(),
    as_json: JsonOption = False,
) -> None:
    """List the recordings in a folder: length, messages, size, and whether they were closed properly."""
    with report_errors(as_json):
        if not folder.is_dir():
            raise RecordingError(f"{folder}: is not a folder")
        rows = [_row(path) for path in sorted(folder.rglob("*.mcap"))]
    print_answer({"folder": str(folder), "recordings": rows}, rows or f"{folder}: no recordings", as_json=as_json)


@app.command()
def cat(
    files: FilesArgument,
    topics: TopicsOption = None,
    exclude: ExcludeOption = None,
    nodes: NodesOption = None,
    start: StartOption = None,
    end: EndOption = None,
    count: CountOption = None,
    same_session: SameSessionOption = False,
) -> None:
    """Print messages with their record fields, one a line as JSON."""
    with report_errors(as_json=False):
        from telenano.recording.channel_filter import some_of
        from telenano.recording.multi_file import open_recordings
        from telenano.recording.recorded_time import span_of
        from telenano.recording.tables import line

        recording = open_recordings(files, same_session=same_session)
        chosen = Selection.of(topics or (), exclude or (), nodes or ())
        chosen.demand_some_of(files[0], recording.channels)
        span_ns = recording.span_ns
        messages = recording.select(chosen, *span_of(span_ns[0], start, end))
        for message in islice(some_of(files[0], messages, span_ns, start, end), count):
            print_json(line(message))


@app.command("filter")
def filter_file(
    file: FileArgument,
    out: OutOption,
    topics: TopicsOption = None,
    exclude: ExcludeOption = None,
    nodes: NodesOption = None,
    start: StartOption = None,
    end: EndOption = None,
    as_json: JsonOption = False,
) -> None:
    """Copy chosen channels and times into a new recording."""
    with report_errors(as_json):
        from telenano.recording.rewrite import filter_recording

        chosen = Selection.of(topics or (), exclude or (), nodes or ())
        _print_model(filter_recording(file, out, chosen, start, end), as_json)


@app.command()
def merge(
    files: FilesArgument,
    out: OutOption,
    sites: Annotated[
        bool,
        typer.Option(
            "--sites",
            help="The files are of the two sites of one session, the master's first: merge on its clock, each message "
            "once.",
        ),
    ] = False,
    same_session: SameSessionOption = False,
    as_json: JsonOption = False,
) -> None:
    """Merge recordings of one session in the order of time."""
    with report_errors(as_json):
        from telenano.recording.rewrite import merge_recordings
        from telenano.recording.site_merge import merge_sites

        merged = merge_sites if sites else merge_recordings
        _print_model(merged(files, out, same_session=same_session), as_json)


@app.command()
def split(
    file: FileArgument,
    out: OutOption,
    interval: Annotated[float | None, typer.Option("--interval", metavar="S", help="Time in each part [s].")] = None,
    size: Annotated[int | None, typer.Option("--size", metavar="BYTES", help="Payload in each part [bytes].")] = None,
    as_json: JsonOption = False,
) -> None:
    """Split a recording into parts."""
    with report_errors(as_json):
        from telenano.recording.rewrite import split_recording

        parts = [
            part.model_dump(mode="json") for part in split_recording(file, out, interval_s=interval, size_bytes=size)
        ]
    shown = [{"path": part["path"], "messages": part["messages"]} for part in parts]
    print_answer({"parts": parts}, shown, as_json=as_json)


@app.command()
def verify(files: FilesArgument, same_session: SameSessionOption = False, as_json: JsonOption = False) -> None:
    """Verify checksums, order, numbers and contents, and list what is missing; exit code 1 if anything is.

    Several files are taken as the parts of one recording, and have to be of one session.
    """
    with report_errors(as_json):
        from telenano.recording.verify import verify as check

        verdict = check(files, same_session=same_session)
    if as_json:
        print_json(verdict.model_dump(mode="json"))
    else:
        for finding in verdict.findings:
            place = f" {finding.channel}" if finding.channel else ""
            typer.echo(f"{finding.level}: {finding.check}: {finding.file}{place}: {finding.text}")
        typer.echo(f"{verdict.messages} messages, {'sound' if verdict.sound else 'not sound'}")
    if not verdict.sound:
        raise typer.Exit(EXIT_FAILED)


@app.command()
def recover(file: FileArgument, out: OutOption, as_json: JsonOption = False) -> None:
    """Copy everything readable in an unfinished, truncated or damaged recording into a complete one."""
    with report_errors(as_json):
        from telenano.recording.rewrite import filter_recording

        _print_model(filter_recording(file, out), as_json)


@app.command()
def export(
    file: FileArgument,
    out: OutOption,
    to: Annotated[
        str,
        typer.Option("--to", metavar="FORMAT", help="mcap-json, or one of a package: parquet, csv, hdf5."),
    ],
    topics: TopicsOption = None,
    exclude: ExcludeOption = None,
    start: StartOption = None,
    end: EndOption = None,
    as_json: JsonOption = False,
) -> None:
    """Convert a recording for other tools; viewers read mcap-json."""
    with report_errors(as_json):
        from telenano.recording.export import export_recording
        from telenano.recording.rewrite import part_of

        with part_of(file, start, end) as part:
            _print_model(export_recording(part, out, to, Selection.of(topics or (), exclude or ())), as_json)


@app.command()
def rerun(
    file: FileArgument,
    node: Annotated[
        list[str],
        typer.Option(
            "--node",
            metavar="NODE@SITE",
            help="Node to run again (repeatable), such as controller@master.",
            autocompletion=node_names,
        ),
    ],
    tolerance: ToleranceOption = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="SECTION.KEY=VALUE", help="Change one key of the recorded scenario (repeatable)."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run a node's code on recorded inputs and compare its output with the recorded one; exit code 1 if it differs."""
    with report_errors(as_json):
        from telenano.recording.field_differences import Tolerances
        from telenano.recording.reader import Recording
        from telenano.rerun.rerun import rerun as run_again

        recording, allowed = Recording(file), Tolerances.parse(tolerance or ())
        results = [run_again(recording, key, allowed, settings or ()) for key in node]
    verdicts = "\n".join(f"{result.node}: {result.verdict()}" for result in results)
    print_answer({"nodes": [result.model_dump(mode="json") for result in results]}, verdicts, as_json=as_json)
    if not all(result.identical for result in results):
        raise typer.Exit(EXIT_FAILED)


def _row(path: Path) -> dict[str, Any]:
    from telenano.recording.reader import Recording
    from telenano.recording.summary_section import quick_info

    try:
        info = (quick_info(path) if _is_long(path) else None) or Recording(path).info()
    except RecordingError as error:
        return {
            "path": str(path),
            "duration_s": None,
            "messages": 0,
            "size_bytes": path.stat().st_size,
            "note": str(error),
        }
    note = "" if info.closed else "not closed properly"
    note = f"{note}, {info.skipped_bytes} bytes damaged".strip(", ") if info.skipped_bytes else note
    note = f"{note}, {info.lost} messages missing".strip(", ") if info.lost else note
    facts = {"path": str(path), "duration_s": round(info.duration_s, 3), "messages": info.messages}
    return {**facts, "size_bytes": info.size_bytes, "note": note}


def _print_model(model: BaseModel, as_json: bool) -> None:
    document = model.model_dump(mode="json")
    print_document(document, str(document.get("path", "")), as_json=as_json)

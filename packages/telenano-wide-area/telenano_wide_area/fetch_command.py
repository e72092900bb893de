"""`telenano bag fetch`: fetch the recording of the slave's site after the session, or continue the fetch."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.cli import JsonOption, SiteFileOption, print_document, report_errors
from telenano.recording import SessionFolder, open_recordings
from telenano.runtime import AddressBook
from telenano.settings import TWO_SITES_FILE
from telenano.wire import RecordingError
from telenano_wide_area.far_recording import fetch_and_merge


def fetch(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a session, as at the master.")],
    site_file: SiteFileOption = TWO_SITES_FILE,
    files: Annotated[
        list[str] | None,
        typer.Option("--file", metavar="NAME", help="Part of the recording there, instead of those that DIR names."),
    ] = None,
    kbit_per_s: Annotated[
        float | None,
        typer.Option(
            "--kbit-per-s", min=64.0, max=1e6, metavar="R", help="Rate of the fetch [kbit/s]; 1000 beside a rig."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Fetch the slave's part of a session's recording, and merge it with DIR; continues a fetch that was ended."""
    with report_errors(as_json):
        session = SessionFolder(folder)
        names = None if files is None else session.parts(files, "--file")
        own, faults = session.own()
        if not own:
            raise RecordingError(f"{folder}: has no recording of the master's site: {'; '.join(faults) or 'no file'}")
        show = (lambda text: None) if as_json else (lambda text: typer.echo(text, err=True))
        whole = fetch_and_merge(AddressBook.load(site_file), session, kbit_per_s, show, names)
        info = open_recordings([whole]).info()
        print_document(info.model_dump(mode="json"), info.path, as_json=as_json)

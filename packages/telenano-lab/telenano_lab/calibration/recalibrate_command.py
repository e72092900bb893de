"""`telenano bag recalibrate`: convert the raw values of real devices in a recording with a better calibration."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.cli import JsonOption, report_errors


def recalibrate(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording (.mcap).")],
    out: Annotated[Path, typer.Option("--out", metavar="PATH", help="File or folder to make, never overwritten.")],
    handle: Annotated[
        Path | None, typer.Option("--handle", metavar="FILE", help="handle.yaml, of the same handle.")
    ] = None,
    stage: Annotated[
        Path | None, typer.Option("--stage", metavar="FILE", help="stage.yaml, of the same instrument.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Apply another calibration to the raw values of real devices, and write a new recording."""
    with report_errors(as_json):
        from telenano.cli import print_document
        from telenano.devices import HandleCalibration, InstrumentCalibration
        from telenano_lab.calibration.recalibrate import recalibrate as read_again

        written = read_again(
            file,
            out,
            handle=None if handle is None else HandleCalibration.from_file(handle),
            stage=None if stage is None else InstrumentCalibration.from_file(stage),
        )
    print_document(written.model_dump(mode="json"), str(out), as_json=as_json)

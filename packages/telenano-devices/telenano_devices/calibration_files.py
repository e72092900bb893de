"""Writes calibration files for commands."""

from pathlib import Path
from typing import Annotated

import typer
import yaml

from telenano.files import atomic_file
from telenano.wire import TelenanoError

WriteOption = Annotated[
    Path | None,
    typer.Option("--calibration", metavar="FILE", help="Write a calibration file that fits the emulated device."),
]


def write_document(path: Path, document: dict[str, object]) -> None:
    """Write a calibration file and print its path; raise TelenanoError if it cannot be written."""
    try:
        with atomic_file(path) as file:
            file.write_text(yaml.safe_dump(document, sort_keys=False))
    except OSError as error:
        raise TelenanoError(f"{path}: cannot be written: {error.strerror}") from error
    typer.echo(f"wrote {path}")

"""Calibration files as commands write them."""

from pathlib import Path

import typer
import yaml

from telenano.files import atomic_file
from telenano.wire import TelenanoError


def write_document(path: Path, document: dict[str, object]) -> None:
    """Write a calibration file; TelenanoError where it cannot be written."""
    try:
        with atomic_file(path) as file:
            file.write_text(yaml.safe_dump(document, sort_keys=False))
    except OSError as error:
        raise TelenanoError(f"{path}: cannot be written: {error.strerror}") from error
    typer.echo(f"wrote {path}")

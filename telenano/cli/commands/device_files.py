"""What the commands of `telenano device` share: scenarios read, calibration files written, scheduling of a device."""

from pathlib import Path
from typing import TypeVar

import typer
import yaml
from pydantic import BaseModel

from telenano.files.atomic_files import atomic_file
from telenano.settings import find_scenario
from telenano.wire.errors import TelenanoError

Section = TypeVar("Section", bound=BaseModel)


def run_ahead() -> None:
    """Request the scheduling of the nodes: a real device has a processor of its own, whatever else runs here."""
    from telenano.runtime.loop.log import StructuredLog, configure_logging
    from telenano.runtime.loop.realtime import apply_realtime, freeze_garbage
    from telenano.settings.scenario import RealtimeConfig

    configure_logging()
    apply_realtime(RealtimeConfig(cpus="free"), StructuredLog("device"), "device")
    freeze_garbage(disable=False)


def section_of(scenario: Path | None, name: str, model: type[Section]) -> Section:
    """Return a section of a scenario that is named or a file, or its defaults; ConfigError names what is wrong."""
    from telenano.settings.scenario import load_scenario

    return model() if scenario is None else load_scenario(find_scenario(str(scenario))).section(name, model)


def write_document(path: Path, document: dict[str, object]) -> None:
    """Write a calibration file; TelenanoError where it cannot be written."""
    try:
        with atomic_file(path) as file:
            file.write_text(yaml.safe_dump(document, sort_keys=False))
    except OSError as error:
        raise TelenanoError(f"{path}: cannot be written: {error.strerror}") from error
    typer.echo(f"wrote {path}")

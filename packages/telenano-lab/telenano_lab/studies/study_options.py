"""Options that the studies share, besides those of their models."""

import re
from pathlib import Path
from typing import Annotated

import typer

from telenano.wire import ConfigError

WorkersOption = Annotated[
    int | None,
    typer.Option(
        "--jobs", "--workers", min=1, metavar="N", help="Processes on this machine; default: one a processor."
    ),
]


def _address(text: str | None) -> str | None:
    """Return the address of a scheduler unchanged; ConfigError if it is not of the form PROTOCOL://HOST:PORT."""
    if text is not None and not re.fullmatch(r"[a-z]+://[^\s/]+:\d+/?", text):
        raise ConfigError(f"--scheduler {text}: is not of the form tcp://host:8786")
    return text


SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        callback=_address,
        help="Dask scheduler, such as tcp://host:8786 (extra `dask`).",
    ),
]
OutOption = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", help="Folder for page, figures, table and journal; resumes a journal."),
]

"""Options that the studies share beside those of their models."""

from pathlib import Path
from typing import Annotated

import typer

WorkersOption = Annotated[
    int | None, typer.Option("--workers", min=1, metavar="N", help="Processes on this machine; default: one a core.")
]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Dask scheduler, such as tcp://host:8786 (extra `dask`)."),
]
OutOption = Annotated[
    Path,
    typer.Option("--out", metavar="DIR", help="Folder for page, figures, table and journal; resumes a journal."),
]

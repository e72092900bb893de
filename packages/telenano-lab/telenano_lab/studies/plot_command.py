"""`telenano bag plot`: draw fields of a recording over time, on the terminal or into a picture."""

import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer

from telenano.cli import EndOption, StartOption, report_errors

# The columns and rows of a drawing where there is no terminal.
_SIZE = (100, 12)


def plot(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Recording (.mcap).")],
    fields: Annotated[
        list[str], typer.Argument(metavar="TOPIC.FIELD", help="Field to draw, such as afm/state.tip_force_n.2.")
    ],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="PNG to make; default: the terminal.")
    ] = None,
    start: StartOption = None,
    end: EndOption = None,
) -> None:
    """Draw fields over time, on the terminal or into a PNG."""
    with report_errors(as_json=False):
        from telenano_lab.studies.plot import draw, read_traces, save_png

        traces = read_traces(file, fields, start, end)
        if out is not None:
            save_png(traces, out, file.name)
            typer.echo(str(out))
            return
        width = shutil.get_terminal_size(_SIZE).columns if sys.stdout.isatty() else _SIZE[0]
        for trace in traces:
            typer.echo(draw(trace, width, _SIZE[1]))

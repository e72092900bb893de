"""`telenano reproduce`: reproduce figures and equations of the paper on one page."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from telenano.cli import EXIT_FAILED, JsonOption, print_json, progress, report_errors, results_in

# Fig. 10 and 12 need a running rig.
PaperFigure = Literal["all", "equations", "fig5", "fig6", "models", "fig8", "fig10", "fig12"]


def reproduce(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for reproduce.html.")],
    what: Annotated[PaperFigure, typer.Argument(help="A figure, the equations, or all of them.")] = "all",
    pixels: Annotated[
        int, typer.Option("--pixels", min=8, max=1024, metavar="N", help="Pixels and lines of fig8.")
    ] = 128,
    as_json: JsonOption = False,
) -> None:
    """Make figures and equations of the paper again, and write them on one HTML page."""
    with report_errors(as_json, "interrupted: the page was not written; sessions that had ended are in their folders"):
        # This import comes first, because it compiles every step that is imported after it.
        from telenano_lab.studies.pages.reproduce import FIGURES
        from telenano_lab.studies.pages.reproduce import reproduce as make

        chosen = FIGURES if what == "all" else (what,)
        with results_in(out, at_once=True), progress("reproduce", shown=not as_json) as show:
            summary = make(chosen, out, pixels, lambda name, n, of: show(n, of, name))
    failed: Any = summary.get("failed", {})
    if as_json:
        print_json(summary)
    else:
        typer.echo(f"page: {out / 'reproduce.html'}")
        for reason in failed.values():
            typer.echo(f"not made: {reason}", err=True)
    if failed:
        raise typer.Exit(EXIT_FAILED)

"""`telenano study gallery`: the effect of delay on each law, on one page with one slider."""

from pathlib import Path
from typing import Annotated, Any

import typer

from telenano.cli import JsonOption, progress, report_errors, results_in
from telenano_lab.studies import option_values
from telenano_lab.studies.pages.gallery import STIFFNESS_N_PER_M, gallery, page_of, write_data
from telenano_lab.studies.study_results import NO_JOURNAL, print_result


def gallery_command(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for the page and its data.")],
    stiffness: Annotated[
        str, typer.Option("--stiffness", metavar="N/M", help="K of the spring [N/m].")
    ] = f"{STIFFNESS_N_PER_M:g}",
    as_json: JsonOption = False,
) -> None:
    """Draw Nyquist curve, roots, course and energy of each law on one page, for one slider of delay."""
    with report_errors(as_json, NO_JOURNAL):
        (stiffness_n_per_m,) = option_values.stiffnesses(stiffness)[:1]
        with progress("cells", shown=not as_json, counted=True) as show:
            document = gallery(stiffness_n_per_m, show)
        with results_in(out) as folder:
            (folder / "gallery.html").write_text(page_of(document), encoding="utf-8")
            write_data(document, folder / "gallery.json")
        delays = document["delays_ms"]
        rows = [
            (law["law"], _theory(law),
             ", ".join(dict.fromkeys(cell["verdict"].replace("_", " ") for cell in law["cells"])),
             next((ms for ms, cell in zip(delays, law["cells"], strict=True) if cell["verdict"] != "stable"), None),
             min(cell["lowest_mj"] for cell in law["cells"]))
            for law in document["laws"]
        ]  # fmt: skip
        head = ("law", "theory [ms]", "verdicts", "first not stable [ms]", "least energy [mJ]")
        summary = {
            "study": "gallery",
            "stiffness_n_per_m": stiffness_n_per_m,
            "laws": [dict(zip(("law", "theory_ms", "verdicts", "first_not_stable_ms", "lowest_mj"), row, strict=True))
                     for row in rows],
        }  # fmt: skip
        print_result(summary, head, rows, out, as_json=as_json)


def _theory(law: dict[str, Any]) -> float | str:
    """Return the round trip that a law tolerates by theory [ms]; a word if there is no number."""
    return ("any" if law["critical_ms"] is None else float(law["critical_ms"])) if law["linear"] else "not linear"

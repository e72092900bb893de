"""`telenano study network`: run each law over a network that `telenano link probe` has measured."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.analysis import Page
from telenano.cli import JsonOption, law_names, report_errors, results_in
from telenano_lab.studies import option_values
from telenano_lab.studies.loops.network import measured_network, rows_of, run_laws
from telenano_lab.studies.study_results import NO_JOURNAL, command_line, print_result, write_study


def network_command(
    probe: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder that `link probe` has written.")] = Path(
        "out/probe"
    ),
    law: Annotated[
        str, typer.Option("--law", metavar="LAW[,LAW]|all", help="Laws to study.", autocompletion=law_names)
    ] = "all",
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder for page and table.")] = Path("out/network"),
    as_json: JsonOption = False,
) -> None:
    """Say which laws are stable over a measured network, in the contact of Fig. 12: with their defaults, and tuned."""
    with report_errors(as_json, NO_JOURNAL):
        laws, network = option_values.laws(law), measured_network(probe)
        records = rows_of(run_laws(laws, network))
        summary = {
            "study": "network",
            "round_trip_ms": network.round_trip_ms,
            "lost_share": network.lost_share,
            "rows": records,
        }
        head, rows = tuple(records[0]), [tuple(record.values()) for record in records]
        page = Page("Laws over a measured network")
        page.code(command_line())
        page.table(head, rows)
        with results_in(out) as folder:
            write_study(folder, page, summary, network=records)
        print_result(summary, head, rows, out, as_json=as_json)

"""`telenano law margins`: what a law keeps with slow devices, and with each of its parameters changed."""

from typing import Annotated

import typer

from telenano.cli.completion import law_name
from telenano.cli.options import JsonOption
from telenano.cli.output import print_answer, report_errors


def margins(
    law: Annotated[
        str, typer.Argument(metavar="LAW", help="Name of a law, as `law list` gives it.", autocompletion=law_name)
    ],
    delay: Annotated[
        float, typer.Option("--delay", min=0.0, max=1e4, metavar="MS", help="Round trip of the link [ms].")
    ] = 120.0,
    stiffness: Annotated[
        float, typer.Option("--stiffness", min=1e-3, max=1e6, metavar="N/M", help="Spring that is pressed [N/m].")
    ] = 20.0,
    latency: Annotated[
        float, typer.Option("--device-latency", min=0.0, max=1e3, metavar="MS", help="Latency of both devices [ms].")
    ] = 15.0,
    as_json: JsonOption = False,
) -> None:
    """Show what a law keeps with slow devices, and with each parameter a fifth more or less."""
    with report_errors(as_json):
        from telenano_studies.loops.margins import as_dict
        from telenano_studies.loops.margins import margins as rows_of

        rows = [as_dict(row) for row in rows_of(law, delay, stiffness, latency)]
    facts = {"law": law, "round_trip_ms": delay, "stiffness_n_per_m": stiffness, "device_latency_ms": latency}
    shown = [{**row, "changed": row["changed"] or "as it comes"} for row in rows]
    print_answer({**facts, "margins": rows}, shown, as_json=as_json)

"""`telenano graph`: the nodes of a rig and the topics between them."""

from typing import Annotated, Literal

import typer

from presets import DEFAULT_SITE_FILE
from proto.errors import RigError
from telenano.cli.options import JsonOption, SiteFileOption
from telenano.cli.output import print_json, print_rows, report_errors


def graph(
    form: Annotated[
        Literal["table", "mermaid", "dot"],
        typer.Option("--format", help="table; mermaid for Markdown; dot for Graphviz."),
    ] = "table",
    live: Annotated[
        float | None,
        typer.Option("--live", min=0.1, metavar="S", help="Measure the rates of a running rig for so long [s]."),
    ] = None,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Draw the nodes of the loop, and the topics between them with their rates [Hz]."""
    with report_errors(as_json):
        from services.runtime.wiring.observer import RIG_HINT, list_topics
        from telenano.cli.commands.topic import open_observer
        from telenano.cli.rig_graph import dot, edges, mermaid

        measured = None
        if live is not None:
            with open_observer(site_file) as observer:
                rows = list_topics(observer, live)
            if not any(row["heard"] for row in rows):
                raise RigError(f"nothing was received within {live:g} s: {RIG_HINT}")
            measured = {row["topic"]: row["heard"] / live for row in rows if "@" not in row["topic"]}
        found = edges(measured)
    if as_json:
        print_json({"edges": [edge._asdict() for edge in found]})
    elif form == "table":
        print_rows(
            [{"from": edge.source, "to": edge.reader, "topic": edge.topic, "Hz": edge.rate_hz} for edge in found]
        )
    else:
        typer.echo(mermaid(found) if form == "mermaid" else dot(found))

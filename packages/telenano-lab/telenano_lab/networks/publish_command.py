"""`telenano topic pub`: publish messages instead of a node that does not run."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.cli import JsonOption, report_errors
from telenano.settings import DEFAULT_SITE_FILE
from telenano.wire import VIEW


def pub(
    topic: Annotated[str, typer.Argument(metavar="TOPIC", help="Topic, such as operator/force.")],
    fields: Annotated[
        str, typer.Argument(metavar="FIELDS", help="Fields of the message as YAML: '{force_n: [0, 0, -0.5]}'.")
    ],
    src: Annotated[
        str,
        typer.Option("--as", metavar="NODE@SITE", help="Node as which the message is published; it must not run."),
    ] = VIEW,
    rate: Annotated[
        float, typer.Option("--rate", min=0.01, max=1000.0, metavar="HZ", help="Messages a second.")
    ] = 10.0,
    count: Annotated[
        int | None, typer.Option("--count", "-n", min=1, metavar="N", help="End after this many messages.")
    ] = None,
    site_file: Annotated[
        Path, typer.Option("--site-file", metavar="FILE", help="Site file with the addresses of the nodes.")
    ] = DEFAULT_SITE_FILE,
    as_json: JsonOption = False,
) -> None:
    """Publish messages instead of a node that does not run, until Ctrl-C or a number; for trials and tests."""
    with report_errors(as_json):
        from telenano.cli import print_answer
        from telenano.runtime import AddressBook, known_name
        from telenano_lab.networks.publish import publish

        sent = publish(AddressBook.load(site_file), src, known_name(topic)[0], fields, rate, count)
    text = f"published {sent} messages on {topic} as {src}"
    print_answer({"topic": topic, "src": src, "sent": sent}, text, as_json=as_json)

"""`telenano conformance`: check a client in any language, and report the rules that it breaks."""

from pathlib import Path
from typing import Annotated

import typer

from telenano.cli import JsonOption, print_json, report_errors
from telenano.testing.conformance.examination import Keys, examine
from telenano.wire import ConfigError


def conformance(
    client: Annotated[
        str, typer.Option("--client", metavar="ADDRESS", help="Endpoint at which the client binds its PUB socket.")
    ],
    rig: Annotated[
        str | None,
        typer.Option(
            "--rig",
            metavar="ADDRESS",
            help="Endpoint that is bound for the client to read, as a console's and a node's; none by default.",
        ),
    ] = None,
    duration: Annotated[float, typer.Option("--duration", min=0.5, help="Time of the examination [s].")] = 10.0,
    server_key: Annotated[
        str | None, typer.Option("--server-key", metavar="KEY", help="Public key of the client's machine, in Z85.")
    ] = None,
    key_file: Annotated[
        Path | None,
        typer.Option("--key-file", help="File NAME.key_secret with your own key pair, which must be allowed."),
    ] = None,
    insecure: Annotated[
        bool, typer.Option("--insecure", help="The client is not encrypted (insecure: true in its site file).")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Connect a client in any language, and print its faults, a line for each rule of the wire.

    The commands sent to it are marks, which move nothing. The exit code is 1 where a rule was broken.
    """
    with report_errors(as_json):
        if (server_key is None) != (key_file is None):
            raise ConfigError("--server-key and --key-file are given together: the client's key, and the own pair")
        keys = None if server_key is None or key_file is None else Keys.of(server_key, key_file)
        findings = examine(client, rig, duration_s=duration, keys=keys, insecure=insecure)
        broken = sum(finding.outcome == "failed" for finding in findings)
        if as_json:
            print_json({"conforms": not broken, "rules": [finding._asdict() for finding in findings]})
        else:
            for finding in findings:
                typer.echo(finding.line())
            typer.echo(f"{broken} of {len(findings)} rules are broken" if broken else "no rule is broken")
        if broken:
            raise typer.Exit(1)

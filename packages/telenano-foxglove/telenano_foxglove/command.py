"""`telenano bridge foxglove`: a running rig for Foxglove and Lichtblick."""

import contextlib
import os
from typing import Annotated

import typer

from telenano.cli import (
    AllowOption,
    CertificateKeyOption,
    CertificateOption,
    DurationOption,
    HostNameOption,
    HostOption,
    SiteFileOption,
    report_errors,
)
from telenano.console import DEFAULT_RATE_HZ, hand_on, live_rig
from telenano.serving import LOOPBACK, Access, announced, bind, checked_tls
from telenano.settings import DEFAULT_SITE_FILE
from telenano_foxglove.bridge import DEFAULT_PORT, Bridge, FoxgloveServer, address_of

TOKEN_VARIABLE = "TELENANO_BRIDGE_TOKEN"


def foxglove(
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    host: HostOption = LOOPBACK,
    port: Annotated[int, typer.Option("--port", min=0, max=65535, metavar="N", help="Port.")] = DEFAULT_PORT,
    certificate: CertificateOption = None,
    key: CertificateKeyOption = None,
    allow: AllowOption = None,
    name: HostNameOption = None,
    allow_origin: Annotated[
        list[str] | None,
        typer.Option(
            "--allow-origin",
            metavar="ORIGIN",
            help="Pages that may connect, as https://app.foxglove.dev, or null (repeatable).",
        ),
    ] = None,
    rate: Annotated[
        float, typer.Option("--rate", min=0.0, metavar="HZ", help="Most of each channel a second; 0: all.")
    ] = DEFAULT_RATE_HZ,
    duration: DurationOption = None,
) -> None:
    """Serve every topic with its schema to Foxglove and Lichtblick, until Ctrl-C; prints the address to open.

    It ends with a token, that of TELENANO_BRIDGE_TOKEN or a new one. Where the output is no terminal it goes to a file
    that only its owner can read.
    """
    with report_errors(False):
        tls = checked_tls(host, certificate, key)
        access = Access.made(
            observer=os.environ.get(TOKEN_VARIABLE, ""),
            names=[host, *(name or ())],
            allow=allow or (),
            # A browser names the origin of its page; a program names none, but has the token.
            origins=["", *(allow_origin or ())],
        )
        with (
            live_rig(site_file) as live,
            bind(host, port, "the bridge") as bound,
            contextlib.closing(FoxgloveServer(bound, access, tls)) as server,
        ):
            address = address_of(server.port, access, host=(name or [host])[0], tls=tls is not None)
            with announced({"open in Foxglove or Lichtblick": address}, typer.echo, "bridge"):
                hand_on(Bridge(server, rate), live, duration)

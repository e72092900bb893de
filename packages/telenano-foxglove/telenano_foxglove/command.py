"""`telenano bridge foxglove`: a running rig for Foxglove and Lichtblick."""

import contextlib
import os
from typing import Annotated, Any

import typer

from telenano.cli import DurationOption, SiteFileOption, report_errors, validated, with_options
from telenano.console import LiveRecording, hand_on, live_rig
from telenano.serving import ViewConfig
from telenano.settings import DEFAULT_SITE_FILE
from telenano_foxglove.bridge import DEFAULT_PORT, Bridge, FoxgloveServer

TOKEN_VARIABLE = "TELENANO_BRIDGE_TOKEN"


@with_options(ViewConfig, leave_out=("port",))
def foxglove(
    given: dict[str, Any],
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    port: Annotated[int, typer.Option("--port", min=0, max=65535, metavar="N", help="Port.")] = DEFAULT_PORT,
    allow_origin: Annotated[
        list[str] | None,
        typer.Option(
            "--allow-origin",
            metavar="ORIGIN",
            help="Pages that may connect, as https://app.foxglove.dev, or null (repeatable).",
        ),
    ] = None,
    rate: Annotated[
        float, typer.Option("--rate", min=0.0, metavar="HZ", help="Most messages of each channel per second; 0: all.")
    ] = LiveRecording.VIEWER_HZ,
    duration: DurationOption = None,
) -> None:
    """Serve every topic with its schema to Foxglove and Lichtblick, until Ctrl-C; prints the address to open.

    It ends with a token, that of TELENANO_BRIDGE_TOKEN or a new one. Where the output is no terminal it goes to a file
    that only its owner can read.
    """
    with report_errors(False):
        config = validated(ViewConfig, {**given, "port": port})
        token = os.environ.get(TOKEN_VARIABLE, "")
        with (
            live_rig(site_file, rate_hz=rate) as live,
            contextlib.closing(FoxgloveServer(config, token, allow_origin or ())) as server,
            server.announced("open in Foxglove or Lichtblick", typer.echo),
        ):
            hand_on(Bridge(server), live, duration)

"""`telenano bridge`: a running rig for the viewers of others."""

import contextlib
import importlib.util
from typing import Annotated

import typer

from presets import DEFAULT_SITE_FILE
from proto.errors import ConfigError, RigError
from services.recorder.live import LiveRecording
from services.runtime.main import load_site
from services.runtime.observer import RIG_HINT, nobody_runs
from telenano.foxglove_bridge import DEFAULT_PORT, DEFAULT_RATE_HZ, Bridge, FoxgloveServer
from telenano.options import DurationOption, SiteFileOption, command_group
from telenano.output import report_errors

app = command_group()


@app.callback()
def bridge() -> None:
    """Hand the messages of a running rig to other programs."""


@app.command()
def foxglove(
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    host: Annotated[
        str, typer.Option("--host", metavar="ADDRESS", help="Address to bind; there is no password.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", min=0, max=65535, metavar="N", help="Port.")] = DEFAULT_PORT,
    rate: Annotated[
        float, typer.Option("--rate", min=0.0, metavar="HZ", help="Most of each channel a second; 0: all.")
    ] = DEFAULT_RATE_HZ,
    duration: DurationOption = None,
) -> None:
    """Serve every topic with its schema to Foxglove and Lichtblick, until Ctrl-C."""
    with report_errors(False):
        if importlib.util.find_spec("foxglove") is None:
            raise ConfigError("foxglove-sdk is not installed: pip install 'telenano[foxglove]'")
        book = load_site(site_file)
        with LiveRecording(book) as live, contextlib.closing(FoxgloveServer(host, port)) as server:
            typer.echo(f"open ws://{host}:{server.port} in Foxglove or Lichtblick")
            if nobody_runs(book):
                # one may be started after its bridge
                typer.echo("telenano: no rig of this site file runs on this machine yet; waiting for one", err=True)
            handed_on = Bridge(server, rate)
            with contextlib.suppress(KeyboardInterrupt):
                handed_on.run(live.messages(duration_s=duration))
            if not handed_on.sent:
                raise RigError(f"nothing was received: {RIG_HINT}")

"""`telenano bridge lsl`: a running rig on the Lab Streaming Layer."""

from typing import Annotated

import typer

from telenano.cli import DurationOption, SiteFileOption, report_errors, say
from telenano.console import hand_on, live_rig
from telenano.settings import DEFAULT_SITE_FILE
from telenano_lsl.bridge import DEFAULT_NAME, LslBridge, lsl_streams


def lsl(
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    name: Annotated[
        str, typer.Option("--name", metavar="NAME", help="What the names of the streams begin with.")
    ] = DEFAULT_NAME,
    duration: DurationOption = None,
) -> None:
    """Publish states, events and trials on the Lab Streaming Layer, until Ctrl-C, with the error of their time.

    It only sends. Streams of LSL are plain, and every machine of the network can find and read them.
    """
    with report_errors(False):
        open_stream, clock = lsl_streams()
        with live_rig(site_file) as live:
            bridge = LslBridge(open_stream, clock, live.epoch_offset_ns, name, live.is_here)
            clocks = bridge.clocks
            typer.echo(
                f"publishing on LSL as {name}; LSL's clock is ahead of the rig's monotonic clock by"
                f" {1e6 * clocks.offset_s:.3f} us, known to {1e6 * clocks.uncertainty_s:.3f} us"
            )
            hand_on(bridge, live, duration)
            if bridge.elsewhere:
                nodes = ", ".join(sorted(bridge.elsewhere))
                say(f"not published: {nodes}, on another machine; start a bridge there")

"""`telenano bridge`: a running rig for the viewers of others."""

import contextlib
import os
from typing import Annotated

import typer

from presets import DEFAULT_SITE_FILE
from proto.errors import ConfigError, RigError
from services.recorder.live import LiveRecording
from services.runtime.bus.observer import RIG_HINT, nobody_runs
from services.runtime.loop.main import load_site
from services.viz_node.access import LOOPBACK, Access
from services.viz_node.serve import announced, bind, checked_tls, missing_packages
from telenano.cli.options import (
    AllowOption,
    CertificateKeyOption,
    CertificateOption,
    DurationOption,
    HostNameOption,
    HostOption,
    SiteFileOption,
    command_group,
)
from telenano.cli.output import report_errors
from telenano.foxglove_bridge import DEFAULT_PORT, DEFAULT_RATE_HZ, Bridge, FoxgloveServer, address_of
from telenano.lsl_bridge import DEFAULT_NAME, LslBridge, lsl_streams
from telenano.ros2_bridge import DEFAULT_ROUTER, Ros2Bridge, close_session, is_connected, zenoh_publishers

TOKEN_VARIABLE = "TELENANO_BRIDGE_TOKEN"

app = command_group()


@app.callback()
def bridge() -> None:
    """Hand the messages of a running rig to other programs."""


@app.command()
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
        if reason := missing_packages("foxglove"):
            raise ConfigError(reason)
        book = load_site(site_file)
        tls = checked_tls(host, certificate, key)
        access = Access.made(
            observer=os.environ.get(TOKEN_VARIABLE, ""),
            names=[host, *(name or ())],
            allow=allow or (),
            # A browser names the origin of its page; a program names none, but has the token.
            origins=["", *(allow_origin or ())],
        )
        with (
            LiveRecording(book) as live,
            bind(host, port, "the bridge") as bound,
            contextlib.closing(FoxgloveServer(bound, access, tls)) as server,
        ):
            address = address_of(server.port, access, host=(name or [host])[0], tls=tls is not None)
            with announced({"open in Foxglove or Lichtblick": address}, typer.echo, "bridge"):
                _hand_on(Bridge(server, rate), live, duration, is_waiting=nobody_runs(book))


@app.command()
def ros2(
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    router: Annotated[
        str,
        typer.Option("--router", metavar="HOST:PORT", help="Router of rmw_zenoh, `ros2 run rmw_zenoh_cpp rmw_zenohd`."),
    ] = DEFAULT_ROUTER,
    domain: Annotated[
        int, typer.Option("--domain", min=0, max=232, metavar="N", envvar="ROS_DOMAIN_ID", help="Domain of ROS.")
    ] = 0,
    namespace: Annotated[str, typer.Option("--namespace", metavar="NAME", help="What stands before each topic.")] = "",
    rate: Annotated[
        float, typer.Option("--rate", min=0.0, metavar="HZ", help="Most of each topic a second; 0: all.")
    ] = DEFAULT_RATE_HZ,
    duration: DurationOption = None,
) -> None:
    """Publish positions and forces in ROS 2 by the names of CRTK, until Ctrl-C; no ROS has to be installed here.

    It only sends: nothing that comes from ROS reaches the rig.
    """
    with report_errors(False):
        book = load_site(site_file)
        with contextlib.ExitStack() as open_parts:
            open_publisher = zenoh_publishers(router, domain)
            open_parts.callback(close_session)
            bridge = open_parts.enter_context(contextlib.closing(Ros2Bridge(open_publisher, rate, namespace)))
            live = open_parts.enter_context(LiveRecording(book))
            typer.echo(f"publishing to the router at {router}, domain {domain}")
            if not is_connected():
                typer.echo(f"telenano: no router answers at {router} yet; the bridge goes on trying", err=True)
            _hand_on(bridge, live, duration, is_waiting=nobody_runs(book))


@app.command()
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
        book = load_site(site_file)
        with LiveRecording(book) as live:
            bridge = LslBridge(open_stream, clock, live.epoch_offset_ns, name, live.is_here)
            found = bridge.clocks
            typer.echo(
                f"publishing on LSL as {name}; LSL's clock is ahead of the rig's monotonic clock by"
                f" {1e6 * found.offset_s:.3f} us, known to {1e6 * found.uncertainty_s:.3f} us"
            )
            _hand_on(bridge, live, duration, is_waiting=nobody_runs(book))
            if bridge.elsewhere:
                nodes = ", ".join(sorted(bridge.elsewhere))
                typer.echo(f"telenano: not published: {nodes}, on another machine; start a bridge there", err=True)


def _hand_on(
    bridge: Bridge | Ros2Bridge | LslBridge, live: LiveRecording, duration: float | None, *, is_waiting: bool
) -> None:
    if is_waiting:
        # A rig may be started after its bridge.
        typer.echo("telenano: no rig of this site file runs on this machine yet; waiting for one", err=True)
    with contextlib.suppress(KeyboardInterrupt):
        bridge.run(live.messages(duration_s=duration))
    if not bridge.sent:
        raise RigError(f"nothing was received: {RIG_HINT}")

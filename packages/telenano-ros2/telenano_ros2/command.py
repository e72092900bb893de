"""`telenano bridge ros2`: a running rig in ROS 2."""

import contextlib
from typing import Annotated

import typer

from telenano.cli import DurationOption, SiteFileOption, report_errors, say
from telenano.console import LiveRecording, hand_on, live_rig
from telenano.settings import DEFAULT_SITE_FILE
from telenano_ros2.bridge import DEFAULT_ROUTER, Ros2Bridge, close_session, is_connected, zenoh_publishers


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
        float, typer.Option("--rate", min=0.0, metavar="HZ", help="Most messages of each topic per second; 0: all.")
    ] = LiveRecording.VIEWER_HZ,
    duration: DurationOption = None,
) -> None:
    """Publish positions and forces in ROS 2 by the names of CRTK, until Ctrl-C; no ROS has to be installed here.

    It only sends: nothing that comes from ROS reaches the rig.
    """
    with report_errors(False), contextlib.ExitStack() as open_parts:
        open_publisher = zenoh_publishers(router, domain)
        open_parts.callback(close_session)
        bridge = open_parts.enter_context(contextlib.closing(Ros2Bridge(open_publisher, namespace)))
        live = open_parts.enter_context(live_rig(site_file, rate_hz=rate))
        typer.echo(f"publishing to the router at {router}, domain {domain}")
        if not is_connected():
            say(f"no router answers at {router} yet; the bridge keeps trying")
        hand_on(bridge, live, duration)

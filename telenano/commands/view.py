"""`telenano view`: the operator's page, of a running rig or of a recording."""

import contextlib
import os
import signal
import socket
import time
from pathlib import Path
from typing import Annotated

import typer

from presets import DEFAULT_SITE_FILE
from proto.errors import ConfigError
from recording.multi_file import open_recordings
from services.runtime.main import load_site
from services.runtime.observer import nobody_runs
from services.runtime.realtime import die_with_parent
from services.viz_node.access import LOOPBACK, Access
from services.viz_node.hub import Hub
from services.viz_node.live import LiveSource
from services.viz_node.playback import RecordingPlayback
from services.viz_node.serve import Tls, address_of, bind, check_exposure, page_folder, serve
from telenano.options import SiteFileOption
from telenano.output import report_errors
from telenano.view_server import SOCKET_VARIABLE, RigCommander, RigHand, forms, missing_for_view, tokens_given

# behind the nodes of the rig: what is shown may come late, what is felt may not
_NICENESS = 5


def view(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILE]...", help="Recording to show, in its parts; without it the running rig."),
    ] = None,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    host: Annotated[
        str, typer.Option("--host", metavar="ADDRESS", help="Address to bind; others need TLS.")
    ] = LOOPBACK,
    port: Annotated[
        int | None, typer.Option("--port", min=0, max=65535, metavar="N", help="Port; default: 8650, or any free one.")
    ] = None,
    certificate: Annotated[
        Path | None, typer.Option("--certificate", metavar="FILE", help="Certificate of this server (PEM).")
    ] = None,
    key: Annotated[Path | None, typer.Option("--key", metavar="FILE", help="Key of the certificate (PEM).")] = None,
    allow: Annotated[
        list[str] | None,
        typer.Option(
            "--allow", metavar="NETWORK", help="Addresses that may connect, beside this machine (repeatable)."
        ),
    ] = None,
    name: Annotated[
        list[str] | None,
        typer.Option("--name", metavar="HOST", help="Name or address by which others open the page (repeatable)."),
    ] = None,
) -> None:
    """Serve the operator's page of a running rig, or of a recording, until Ctrl-C; prints the addresses to open.

    The token of the operator is in TELENANO_VIEW_OPERATOR_TOKEN, that of observers in TELENANO_VIEW_OBSERVER_TOKEN;
    without them new ones are made.
    """
    with report_errors(False):
        if reason := missing_for_view():
            raise ConfigError(f"the view cannot be served: {reason}")
        if (certificate is None) != (key is None):
            raise ConfigError("--certificate and --key belong together: give both")
        tls = Tls(certificate, key) if certificate is not None and key is not None else None
        check_exposure(host, tls)
        access = Access.made(names=[host, *(name or ())], allow=allow or (), **tokens_given())
        hub = _hub_of(files or (), site_file)
        inherited = _inherited()
        bound = inherited or bind(host, port)
        os.nice(_NICENESS)
        if inherited is None and not files and nobody_runs(load_site(site_file)):
            # one may be started after its page
            typer.echo("telenano: no rig of this site file runs on this machine yet; the page waits for one", err=True)
        # after the last thing that could fail: whoever reads this may open it
        for role, observer in (("operator", False), ("observer", True)):
            shown = (name or [""])[0]
            typer.echo(f"{role}: {address_of(bound, access, tls=tls is not None, observer=observer, name=shown)}")
        # imports starlette, which is an extra
        from services.viz_node.server import make_app

        # how a person ends it
        with contextlib.suppress(KeyboardInterrupt):
            serve(make_app(hub, access, page_folder()), bound, tls)


def _hub_of(files: list[Path] | tuple[Path, ...], site_file: Path) -> Hub:
    if files:
        return Hub(RecordingPlayback(open_recordings(files), time.monotonic))
    return Hub(
        LiveSource(load_site(site_file), str(site_file)), RigCommander(site_file), forms, lambda: RigHand(site_file)
    )


def _inherited() -> socket.socket | None:
    """Return the socket that `telenano up` has bound for this process, and end with that one."""
    number = os.environ.pop(SOCKET_VARIABLE, "")
    if not number:
        return None
    die_with_parent(signal.SIGTERM)
    return socket.socket(fileno=int(number))

"""`telenano view`: the operator's page, of a running rig or of a recording."""

import contextlib
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from presets import DEFAULT_SITE_FILE
from proto.errors import ConfigError, RigError, TelenanoError
from proto.nodes import VIEW
from recording.multi_file import open_recordings
from services.launcher.restart_policy import RestartPolicy, RestartTracker
from services.runtime.bus.observer import nobody_runs
from services.runtime.loop.clock import SystemClock
from services.runtime.loop.main import load_site
from services.runtime.loop.realtime import die_with_parent
from services.viz_node.access import LOOPBACK, Access
from services.viz_node.connections import Listener
from services.viz_node.hub import Hub
from services.viz_node.live import LiveSource
from services.viz_node.playback import RecordingPlayback
from services.viz_node.serve import address_of, bind, checked_tls, page_folder, serve
from telenano.cli.options import (
    AllowOption,
    CertificateKeyOption,
    CertificateOption,
    HostNameOption,
    HostOption,
    SiteFileOption,
)
from telenano.cli.output import report_errors
from telenano.view_server import (
    SOCKET_VARIABLE,
    RigCommander,
    RigHand,
    announced,
    forms,
    missing_for_view,
    tokens_given,
)

# behind the nodes of the rig: what is shown may come late, what is felt may not
_NICENESS = 5


def view(
    files: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILE]...", help="Recording to show, in its parts; without it the running rig."),
    ] = None,
    site_file: SiteFileOption = DEFAULT_SITE_FILE,
    host: HostOption = LOOPBACK,
    port: Annotated[
        int | None, typer.Option("--port", min=0, max=65535, metavar="N", help="Port; default: 8650, or any free one.")
    ] = None,
    certificate: CertificateOption = None,
    key: CertificateKeyOption = None,
    allow: AllowOption = None,
    name: HostNameOption = None,
) -> None:
    """Serve the operator's page of a running rig, or of a recording, until Ctrl-C; prints the addresses to open.

    Where the output is no terminal, the addresses go to a file that only its owner can read: they end with the tokens.

    The token of the operator is in TELENANO_VIEW_OPERATOR_TOKEN, that of observers in TELENANO_VIEW_OBSERVER_TOKEN;
    without them new ones are made.
    """
    with report_errors(False):
        if reason := missing_for_view():
            raise ConfigError(f"the view cannot be served: {reason}")
        tls = checked_tls(host, certificate, key)
        access = Access.made(names=[host, *(name or ())], allow=allow or (), **tokens_given())
        make_hub = _hubs_of(files or (), site_file)
        hub = make_hub()
        inherited = _inherited()
        bound = inherited or bind(host, port)
        os.nice(_NICENESS)
        if inherited is None and not files and nobody_runs(load_site(site_file)):
            # one may be started after its page
            typer.echo("telenano: no rig of this site file runs on this machine yet; the page waits for one", err=True)
        shown = (name or [""])[0]
        addresses = {
            role: address_of(bound, access, tls=tls is not None, observer=observer, name=shown)
            for role, observer in (("operator", False), ("observer", True))
        }
        signal.signal(signal.SIGTERM, _leave)
        # after the last thing that could fail: whoever reads this may open it; and a person ends it with Ctrl-C
        with (
            announced(addresses, typer.echo) if inherited is None else contextlib.nullcontext(),
            contextlib.suppress(KeyboardInterrupt),
        ):
            _serve_again(make_hub, hub, lambda hub: serve(hub, access, page_folder(), bound, tls), inherited is None)


def _serve_again(make_hub: Callable[[], Hub], hub: Hub, serve_once: Callable[[Hub], None], again: bool) -> None:
    """Serve until the server is ended. Where something unforeseen ends it, say so, and begin `again` with a new hub."""
    restarts = RestartTracker(SystemClock(), [VIEW], RestartPolicy(crash_loop_exits=sys.maxsize))
    while True:
        restarts.record_start(VIEW)
        try:
            return serve_once(hub)
        except TelenanoError as error:
            raise type(error)(f"the view has ended: {error}") from error
        except Exception as error:
            text = f"the view has ended: {type(error).__name__}: {error}"
            if not again:
                # who started this process starts another one
                raise RigError(text) from error
            end = restarts.record_exit(VIEW, 1)
            typer.echo(f"telenano: {text}; {end.verdict}", err=True)
            hub.close()
            time.sleep(end.restart_in_s or 0.0)
            hub = make_hub()


def _leave(number: int, frame: object) -> NoReturn:
    """End as after Ctrl-C, so that what has to be put away is."""
    raise SystemExit(128 + number)


def _hubs_of(files: list[Path] | tuple[Path, ...], site_file: Path) -> Callable[[], Hub]:
    """Return what makes the hub of a recording or of a running rig."""
    if files:
        recordings = open_recordings(files)
        return lambda: Hub(RecordingPlayback(recordings, time.monotonic))
    commander = RigCommander(site_file)
    return lambda: Hub(LiveSource(load_site(site_file), str(site_file)), commander, forms, lambda: RigHand(site_file))


def _inherited() -> Listener | None:
    """Return the socket that `telenano up` has bound for this process, and end with that one."""
    number = os.environ.pop(SOCKET_VARIABLE, "")
    if not number:
        return None
    die_with_parent(signal.SIGTERM)
    return Listener(fileno=int(number))

"""Binding and running the web server of the page."""

import socket
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from proto.errors import ConfigError, EndpointError
from services.viz_node.access import LOOPBACK, Access, is_loopback
from services.viz_node.connections import Connections, Listener, most_connections

if TYPE_CHECKING:
    import uvicorn

    from services.viz_node.hub import Hub

DEFAULT_PORT = 8650
_WEB = Path(__file__).parent / "web"
_BACKLOG = 64
_PING_S = 5.0
_STOP_S = 1
# a browser opens six connections at once
_LEAST_STRANGERS = 8


class Tls(NamedTuple):
    """Files of the certificate and of its key, in PEM."""

    certificate: Path
    key: Path


def page_folder() -> Path | None:
    """Return the folder of the built page, None where it has not been built."""
    folder = _WEB / "dist"
    return folder if (folder / "index.html").is_file() else None


def bind(host: str = LOOPBACK, port: int | None = None, what: str = "the view") -> Listener:
    """Bind an address; without a port the usual one of the view, or any other where that one is taken.

    Raises: EndpointError with the reason.
    """
    for wanted in (DEFAULT_PORT, 0) if port is None else (port,):
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        bound = Listener(family, socket.SOCK_STREAM)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            bound.bind((host.strip("[]"), wanted))
            bound.listen(_BACKLOG)
        except OSError as error:
            bound.close()
            fault = EndpointError(f"{what} cannot bind {host}:{wanted}: {error.strerror or error}: give another --port")
        else:
            return bound
    raise fault


def checked_tls(host: str, certificate: Path | None, key: Path | None) -> Tls | None:
    """Return the files of TLS, None without; ConfigError where one is missing or the host needs them."""
    if (certificate is None) != (key is None):
        raise ConfigError("--certificate and --key belong together: give both")
    tls = Tls(certificate, key) if certificate is not None and key is not None else None
    check_exposure(host, tls)
    return tls


def check_exposure(host: str, tls: Tls | None) -> None:
    """Raise ConfigError for a server that others could reach without encryption: they could read the token."""
    if not is_loopback(host) and tls is None:
        raise ConfigError(
            f"--host {host}: beyond this machine the token and every command would cross the network in the clear: "
            "give --certificate and --key (docs/view.md), or leave it at 127.0.0.1 and use `ssh -L`"
        )
    for file in tls or ():
        if not file.is_file():
            raise ConfigError(f"{file}: is not a file; a certificate and its key in PEM are needed")


def address_of(bound: socket.socket, access: Access, *, tls: bool, observer: bool = False, name: str = "") -> str:
    """Return the address to open, with the token behind # where it reaches no server and no log."""
    host, port = bound.getsockname()[:2]
    shown = name or (f"[{host}]" if ":" in host else host)
    token = access.observer_token if observer else access.operator_token
    return f"{'https' if tls else 'http'}://{shown}:{port}/#{token}"


def serve(hub: "Hub", access: Access, page: Path | None, bound: Listener, tls: Tls | None = None) -> None:
    """Serve the page of a hub until SIGINT or SIGTERM. Raises what ended the hub, if something did."""
    from services.viz_node.server import MOST_PAGES, make_app

    # the web server closes what it is given, and may be started again
    listener = bound.again(Connections(most_connections(MOST_PAGES + _LEAST_STRANGERS)))
    server = make_server(make_app(hub, access, page, listener.connections), tls)
    hub.on_end = lambda: setattr(server, "should_exit", True)
    server.run(sockets=[listener])
    if hub.fault is not None:
        raise hub.fault


def make_server(app: Any, tls: Tls | None = None) -> "uvicorn.Server":
    """Return a server with the limits of the page: a larger frame ends its connection before it is read."""
    import uvicorn

    from services.viz_node.requests import LARGEST_FRAME

    config = uvicorn.Config(
        app,
        loop="asyncio",
        # a stranger can cause any number of warnings
        log_level="error",
        access_log=False,
        server_header=False,
        # the application does it behind the account of connections
        proxy_headers=False,
        ws_max_size=LARGEST_FRAME,
        ws_max_queue=32,
        ws_ping_interval=_PING_S,
        ws_ping_timeout=_PING_S,
        timeout_graceful_shutdown=_STOP_S,
        ssl_certfile=str(tls.certificate) if tls else None,
        ssl_keyfile=str(tls.key) if tls else None,
    )
    return uvicorn.Server(config)

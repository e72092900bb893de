"""Binding and running the web server of the page, and telling its address to whom it is for."""

import contextlib
import os
import re
import socket
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib import resources, util
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import urlsplit

from telenano.files.atomic_files import write_whole
from telenano.runtime.bus.local_endpoint import rig_directory, rigs_with_folders, runtime_directory
from telenano.runtime.security.private_files import check_runtime_directory, read_secret
from telenano.serving.access import LOOPBACK, Access, is_loopback
from telenano.serving.connections import Listener
from telenano.serving.panels import installed_panels
from telenano.wire.errors import ConfigError, EndpointError, TelenanoError
from telenano.wire.extras import how_to_install
from telenano.wire.nodes import PAGE, module_of, name_of

if TYPE_CHECKING:
    import uvicorn

DEFAULT_PORT = 8650
# the number of a socket that the launcher has bound for this process
SOCKET_VARIABLE = "TELENANO_VIEW_SOCKET"
_PACKAGES = ("starlette", "uvicorn", "websockets")
# largest frame of a web socket [bytes]
LARGEST_FRAME = 1 << 16
_BACKLOG = 64
_PING_S = 5.0
_STOP_S = 1
# The names of the files that have the addresses of servers end with this.
_ADDRESSES = ".addresses"
# A server has this time to answer when its file is found.
_LOOK_S = 0.5


class Tls(NamedTuple):
    """Files of the certificate and of its key, in PEM."""

    certificate: Path
    key: Path


def web_folder() -> Path:
    """Return the folder of the page's sources and of what it shares with other pages: `web_folder() / "gallery"`."""
    return Path(str(resources.files(module_of(name_of(PAGE))))) / "web"


def page_folder() -> Path | None:
    """Return the folder of the built page, None where it has not been built."""
    folder = web_folder() / "dist"
    return folder if (folder / "index.html").is_file() else None


def missing_for_view() -> str:
    """Return in words what this installation lacks to serve the page; empty when it lacks nothing."""
    if absent := [name for name in _PACKAGES if util.find_spec(name) is None]:
        return f"{', '.join(absent)} {'are' if len(absent) > 1 else 'is'} not installed: {how_to_install('view')}"
    if page_folder() is None:
        return "its page has not been built: `make page` in the repository builds it"
    return ""


def inherited() -> Listener | None:
    """Return the socket that the launcher has bound for this process, None where it is to bind its own."""
    number = os.environ.pop(SOCKET_VARIABLE, "")
    return Listener(fileno=int(number)) if number else None


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
        raise ConfigError("a certificate and its key belong together: give both (--certificate and --key)")
    tls = Tls(certificate, key) if certificate is not None and key is not None else None
    check_exposure(host, tls)
    return tls


def check_exposure(host: str, tls: Tls | None) -> None:
    """Raise ConfigError for a server that others could reach without encryption: they could read the token."""
    if not is_loopback(host) and tls is None:
        raise ConfigError(
            f"host {host}: beyond this machine the token and every command would cross the network in the clear: give "
            "--certificate and --key (in a scenario viz_node.certificate_file and key_file, docs/view.md), or "
            "leave it at 127.0.0.1 and use `ssh -L`"
        )
    for file in tls or ():
        if not file.is_file():
            raise ConfigError(f"{file}: is not a file; a certificate and its key in PEM are needed")


def addresses_of(bound: socket.socket, access: Access, tls: Tls | None, name: str = "") -> dict[str, str]:
    """Return the addresses for each role to open, with the token behind # where it reaches no server and no log."""
    host, port = bound.getsockname()[:2]
    shown = name or (f"[{host}]" if ":" in host else host)
    base = f"{'https' if tls else 'http'}://{shown}:{port}/"
    addresses = {"operator": f"{base}#{access.operator_token}", "observer": f"{base}#{access.observer_token}"}
    if panel := installed_panels().of_guests:
        addresses["participant"] = f"{base}{panel.base}{panel.guest_page}#{access.participant_token}"
    return addresses


@contextlib.contextmanager
def announced(addresses: Mapping[str, str], show: Callable[[str], None], what: str = "view") -> Iterator[None]:
    """Keep the addresses of a server in a private file while the block runs, and show them on a terminal.

    An address ends with the token, and what goes to a pipe or a file is kept: logs of containers and of services.
    There the output says how to get it instead (`served_addresses`).

    Args:
        addresses: The addresses by what they are called.
        show: Prints a line.
        what: The name of the server.
    """
    base = re.split("[#?]", next(iter(addresses.values())))[0]
    file = runtime_directory() / f"{what}-{base.rstrip('/').rpartition(':')[2]}{_ADDRESSES}"
    is_terminal = sys.stdout.isatty()
    fault = ""
    try:
        check_runtime_directory(make=True)
        text = "".join(f"{name}: {address}\n" for name, address in addresses.items())
        write_whole(file, text.encode(), is_forced=False)
    except OSError as error:
        fault = f"{what}: the address cannot be kept: {file}: {error.strerror}"
    except TelenanoError:
        # A terminal shows all that a person needs, also where no file can be written.
        if not is_terminal:
            raise
    if is_terminal:
        for name, address in addresses.items():
            show(f"{name}: {address}")
    else:
        show(f"{what}: {base}")
        text = "the address needs a token, written to no pipe and no log: `telenano view --addresses` prints it"
        show(fault or f"{text}, and only you can read it in the file {file}")
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            file.unlink()


def served_addresses(folders: Sequence[Path] | None = None) -> list[str]:
    """Return a line for each address of the servers of this user that answer, by what the address is called.

    Args:
        folders: The folders of the rigs that are meant; None for all.
    """
    addresses = []
    for folder in [rig_directory(rig) for rig in rigs_with_folders()] if folders is None else folders:
        for file in sorted(folder.glob(f"*{_ADDRESSES}")):
            port = file.name.removesuffix(_ADDRESSES).rpartition("-")[2]
            with contextlib.suppress(OSError):
                lines = read_secret(file).decode().splitlines()
                # A server that was killed leaves its file behind.
                if port.isdecimal() and any(_answers(line, int(port)) for line in lines):
                    addresses += lines
    return addresses


def _answers(line: str, port: int) -> bool:
    """Return whether a server takes connections at the host of an address, or at this machine's own."""
    host = urlsplit(line.partition(": ")[2]).hostname or LOOPBACK
    for name in (LOOPBACK, host):
        with contextlib.suppress(OSError), socket.create_connection((name, port), timeout=_LOOK_S):
            return True
    return False


def make_server(app: Any, tls: Tls | None = None) -> "uvicorn.Server":
    """Return a server with the limits of the page: a larger frame ends its connection before it is read."""
    import uvicorn

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

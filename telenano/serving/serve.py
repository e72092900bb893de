"""Binding and running the page's web server, and showing its address only to its user."""

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
# Environment variable with the descriptor of a socket that the launcher bound for this process.
SOCKET_VARIABLE = "TELENANO_VIEW_SOCKET"
# Command that prints the addresses of a server whose terminal is a log, such as one in a container.
COMMAND_VARIABLE = "TELENANO_ADDRESSES_COMMAND"
_PACKAGES = ("starlette", "uvicorn", "websockets")
# Largest frame of a web socket [bytes].
LARGEST_FRAME = 1 << 16
_BACKLOG = 64
_PING_S = 5.0
_STOP_S = 1
# Suffix of the files with the addresses of servers.
_ADDRESSES = ".addresses"
# Longest wait for a connection to a server whose file was found [s].
_LOOK_S = 0.5


class Tls(NamedTuple):
    """Files of the certificate and of its key, in PEM."""

    certificate: Path
    key: Path


def web_folder() -> Path:
    """Return the folder of the page's sources, also of those shared with other pages: `web_folder() / "gallery"`."""
    return Path(str(resources.files(module_of(name_of(PAGE))))) / "web"


def page_folder() -> Path | None:
    """Return the folder of the built page; None if it has not been built."""
    folder = web_folder() / "dist"
    return folder if (folder / "index.html").is_file() else None


def missing_for_view() -> str:
    """Return a sentence on the packages or files that are missing to serve the page; empty if there are none."""
    if absent := [name for name in _PACKAGES if util.find_spec(name) is None]:
        return f"{', '.join(absent)} {'are' if len(absent) > 1 else 'is'} not installed: {how_to_install('view')}"
    if page_folder() is None:
        return "its page has not been built: `make page` in the repository builds it"
    return ""


def inherited() -> Listener | None:
    """Return the socket that the launcher bound for this process; None if there is none."""
    number = os.environ.pop(SOCKET_VARIABLE, "")
    return Listener(fileno=int(number)) if number else None


def bind(host: str = LOOPBACK, port: int | None = None, what: str = "the view") -> Listener:
    """Bind an address and return the listener; without a port use the default one, or any other if that is taken.

    Raises EndpointError, with the reason, if the address cannot be bound; `what` names the server in it.
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
    """Return the TLS files, None without; raise ConfigError if one is missing or the host requires them."""
    if (certificate is None) != (key is None):
        raise ConfigError("a certificate and its key belong together: give both (--certificate and --key)")
    tls = Tls(certificate, key) if certificate is not None and key is not None else None
    check_exposure(host, tls)
    return tls


def check_exposure(host: str, tls: Tls | None) -> None:
    """Raise ConfigError if other machines could reach the server without encryption, or if a TLS file is missing."""
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
    """Return the address for each role; the token follows `#`, so that browsers send it to no server and no log."""
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

    An address ends with the token, and output to a pipe or a file persists, such as logs of containers and services. In
    that case the output only says how to get the address (`served_addresses`).

    Args:
        addresses: The addresses, by name.
        show: Function that prints a line.
        what: The name of the server.

    Raises:
        TelenanoError: The private folder is unsafe and the output is no terminal.
    """
    base = re.split("[#?]", next(iter(addresses.values())))[0]
    file = runtime_directory() / f"{what}-{base.rstrip('/').rpartition(':')[2]}{_ADDRESSES}"
    # The terminal of a container of Compose is its log, which anyone may read who may use the engine.
    command = os.environ.get(COMMAND_VARIABLE)
    is_terminal = sys.stdout.isatty() and not command
    fault = ""
    try:
        check_runtime_directory(make=True)
        text = "".join(f"{name}: {address}\n" for name, address in addresses.items())
        write_whole(file, text.encode(), is_forced=False)
    except OSError as error:
        fault = f"{what}: the address cannot be kept: {file}: {error.strerror}"
    except TelenanoError:
        # A terminal shows the addresses even if no file can be written.
        if not is_terminal:
            raise
    if is_terminal:
        for name, address in addresses.items():
            show(f"{name}: {address}")
    else:
        show(f"{what}: {base}")
        command = command or "telenano view --addresses"
        text = f"the address needs a token, written to no pipe and no log: `{command}` prints it"
        show(fault or f"{text}, and only you can read it in the file {file}")
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            file.unlink()


def served_addresses(folders: Sequence[Path] | None = None) -> list[str]:
    """Return a line `NAME: ADDRESS` for each address of this user's servers that answer.

    Args:
        folders: The folders of the wanted rigs; None for all.
    """
    addresses = []
    for folder in [rig_directory(rig) for rig in rigs_with_folders()] if folders is None else folders:
        for file in sorted(folder.glob(f"*{_ADDRESSES}")):
            port = file.name.removesuffix(_ADDRESSES).rpartition("-")[2]
            with contextlib.suppress(OSError):
                lines = read_secret(file).decode().splitlines()
                # A killed server leaves its file behind, so only those that answer count.
                if port.isdecimal() and any(_answers(line, int(port)) for line in lines):
                    addresses += lines
    return addresses


def _answers(line: str, port: int) -> bool:
    """Return whether a server accepts connections on a port, at the loopback address or the host of an address line."""
    host = urlsplit(line.partition(": ")[2]).hostname or LOOPBACK
    for name in (LOOPBACK, host):
        with contextlib.suppress(OSError), socket.create_connection((name, port), timeout=_LOOK_S):
            return True
    return False


def make_server(app: Any, tls: Tls | None = None) -> "uvicorn.Server":
    """Return a web server with the limits of the page: a frame beyond `LARGEST_FRAME` ends its connection unread."""
    import uvicorn

    config = uvicorn.Config(
        app,
        loop="asyncio",
        # Any client can cause any number of warnings.
        log_level="error",
        access_log=False,
        server_header=False,
        # The gate handles proxy headers, after the account of connections.
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

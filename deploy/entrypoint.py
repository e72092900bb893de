"""Prepare a container before its program: the cache, the clock of the rig, the scenario in force."""

import os
import shutil
import socket
import sys
import time
from pathlib import Path

import yaml

from telenano.cli.exit_codes import EXIT_BAD_CONFIGURATION
from telenano.runtime.bus.local_endpoint import runtime_directory
from telenano.runtime.security.private_files import check_runtime_directory
from telenano.settings.config import ENVIRONMENT_PREFIX, layered
from telenano.settings.included import DEFAULT_SITE_FILE, SCENARIO_DIRECTORY, anchored
from telenano.signals import children
from telenano.timing.clock import EPOCH_OFFSET_VARIABLE
from telenano.wire.errors import ConfigError
from telenano.wire.nodes import PAGE, module_of

# the cache that the build filled; the image is read-only, and a study compiles more
PREPARED = Path("/opt/cache")
IN_FORCE = Path("/tmp/scenario.yaml")
# where the page is served, by the network of the machine
LOOPBACK = "127.0.0.1"
LAST_PORT = 65535
PAGE_PORT = "TELENANO__VIZ_NODE__PORT"
# The node to run is given as node@site.
NODE = "TELENANO_NODE"
MACHINE = "TELENANO_MACHINE"
SITE_FILE = "TELENANO_SITE_FILE"
SCENARIO = "TELENANO_SCENARIO"
RATE = f"{ENVIRONMENT_PREFIX}REALTIME__RATE_HZ"
# Six nodes, a page and a session reach 1 kHz in containers with this many processors; fewer hold the loop up.
PROCESSORS = 4
RATE_OF_FEW_HZ = 500.0


def main(command: list[str]) -> None:
    """Replace this process by the command if one is given, else by the node that the environment names."""
    cache = Path(os.environ["XDG_CACHE_HOME"])
    if PREPARED.is_dir() and not cache.exists():
        # A container that is killed meanwhile leaves no half of it.
        shutil.copytree(PREPARED, cache.with_suffix(".part"), dirs_exist_ok=True)
        cache.with_suffix(".part").rename(cache)
    node = os.environ.get(NODE, "")
    try:
        if node and EPOCH_OFFSET_VARIABLE not in os.environ:
            check_runtime_directory()
            os.environ[EPOCH_OFFSET_VARIABLE] = str(shared_epoch_offset_ns(runtime_directory()))
        choose_rate(len(os.sched_getaffinity(0)))
        program = command or node_command(node)
    except ConfigError as error:
        sys.stderr.write(f"{error}\n")
        raise SystemExit(EXIT_BAD_CONFIGURATION) from error
    children.become(program)


def node_command(node: str) -> list[str]:
    """Return the command line of a node and write its scenario; ConfigError when there is none, or no node."""
    if node == PAGE:
        check_port(os.environ.get(PAGE_PORT, ""))
    name, _, site = node.partition("@")
    if not site:
        raise ConfigError(f"{NODE} is {node!r}: give a command, or the node to run as node@site")
    site_file = os.environ.get(SITE_FILE) or str(DEFAULT_SITE_FILE)
    write_in_force(scenario_of_rig())
    files = ["--site-file", site_file, "--scenario", str(IN_FORCE)]
    return [sys.executable, "-m", module_of(name), *files, "--site", site]


def check_port(text: str) -> None:
    """Raise ConfigError where the page cannot have its port of this machine, by the variable that sets the port."""
    # What is no number of a port is reported with the setting.
    if not text.isdecimal() or int(text) > LAST_PORT:
        return
    with socket.socket() as probe:
        # as the server of the page does, for which a connection that was just closed is no other server
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, int(text)))
            probe.listen()
        except OSError as error:
            raise ConfigError(
                f"no page: port {text} of {LOOPBACK}: {error.strerror}: set VIEW_PORT to another one, in .env or as in "
                "`VIEW_PORT=8651 docker compose up`; the rig runs without its page"
            ) from error


def scenario_of_rig() -> Path:
    """Return the file of the scenario that all containers of the rig have."""
    return Path(os.environ.get(SCENARIO) or SCENARIO_DIRECTORY / "fig12.yaml")


def choose_rate(processors: int) -> None:
    """Give the rig of a machine with few processors half the rate, where neither scenario nor environment gives one.

    The sites of two machines have one rate, whatever processors each of them has, so it is left as it is. ConfigError
    when the scenario cannot be read.
    """
    if processors >= PROCESSORS or os.environ.get(MACHINE):
        return
    document, _ = layered(scenario_of_rig())
    if "rate_hz" not in (document.get("realtime") or {}):
        os.environ[RATE] = f"{RATE_OF_FEW_HZ:g}"
        sys.stderr.write(
            f"{processors} processors: the rig runs at {RATE_OF_FEW_HZ:g} Hz; {RATE} in .env gives another rate\n"
        )


def write_in_force(scenario: Path) -> None:
    """Write a scenario merged with the environment, as `telenano up` does: the recorder keeps this very file."""
    document, _ = layered(scenario)
    text = yaml.safe_dump(anchored(document, scenario.absolute().parent), sort_keys=False)
    IN_FORCE.write_text(text, encoding="utf-8")
    for name in [name for name in os.environ if name.startswith(ENVIRONMENT_PREFIX)]:
        del os.environ[name]


def shared_epoch_offset_ns(folder: Path) -> int:
    """Return the offset between monotonic clock and epoch [ns] that all containers with one folder of sockets share.

    The wall clock may be set between the start of a rig and the restart of a node, whose stamps would then be wrong.
    """
    shared = folder / "epoch_offset_ns"
    own = folder / f"{shared.name}.{os.uname().nodename}"
    own.write_text(str(time.time_ns() - time.monotonic_ns()), encoding="ascii")
    try:
        # Exactly one of the containers that start together creates it.
        shared.hardlink_to(own)
    except FileExistsError:
        pass
    finally:
        own.unlink()
    return int(shared.read_text(encoding="ascii"))


if __name__ == "__main__":
    main(sys.argv[1:])

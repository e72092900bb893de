"""The health check of a container: it reads the node/health of a node on this machine.

It runs every few seconds beside a 1 kHz loop, so it imports very little: without --site-file only ZeroMQ and msgpack,
which take, with the start of Python, 0.05 s of processor time.
"""

import argparse
import os
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgpack
import zmq

from telenano.runtime.bus.local_endpoint import RUNTIME_DIRECTORY_VARIABLE

NODE_VARIABLE = "TELENANO_NODE"
TOPIC = b"node/health"
UNHEALTHY_STATES = ("starting", "stopping")
# Default time to wait for node/health, which is sent twice a second [s].
DEFAULT_WITHIN_S = 3.0
_LARGEST_FRAME = 1 << 20


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the state of a node; return 0 if it is healthy, 1 if it is not, 2 if it cannot be checked."""
    options = _parser().parse_args(arguments)
    if not options.node:
        return _report(2, f"no node was named: give node@site, or set {NODE_VARIABLE}")
    try:
        endpoint = endpoint_of(options.node, options.site_file)
    except LookupError as error:
        return _report(2, str(error.args[0]))
    health = receive_health(endpoint, options.node, options.within)
    if health is None:
        return _report(1, f"{options.node} sent no node/health at {endpoint} within {options.within:g} s")
    text = f"{options.node} is {health['state']} at {health['rate_hz']:.0f} Hz, up for {health['uptime_s']:.0f} s"
    return _report(int(health["state"] in UNHEALTHY_STATES), text)


def endpoint_of(node: str, site_file: Path | None) -> str:
    """Return the endpoint of a node for readers on this machine.

    Args:
        node: The node as node@site.
        site_file: The site file; None if every node has a socket of its name in the folder TELENANO_RUNTIME_DIR, as in
            the site files of the project.

    Raises:
        LookupError: The file is invalid, or no folder is set.
        KeyError: The node is not in the file.
    """
    if site_file is not None:
        # These imports load the models of all messages, which takes a third of a second of processor time.
        from telenano.runtime.bus.address_book import AddressBook
        from telenano.wire.errors import TelenanoError

        try:
            return AddressBook.load(site_file).endpoint(node)
        except TelenanoError as error:
            raise LookupError(str(error)) from error
    folder = os.environ.get(RUNTIME_DIRECTORY_VARIABLE)
    if not folder:
        raise LookupError(f"the endpoint of {node} is not known: give --site-file, or set {RUNTIME_DIRECTORY_VARIABLE}")
    return f"ipc://{folder}/{node}"


def receive_health(endpoint: str, node: str, within_s: float) -> Mapping[str, Any] | None:
    """Wait for one node/health of a node, at most `within_s` [s]; return None if none arrives in time."""
    end_s = time.monotonic() + within_s
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.set(zmq.LINGER, 0)
        socket.set(zmq.MAXMSGSIZE, _LARGEST_FRAME)
        socket.subscribe(TOPIC)
        socket.connect(endpoint)
        while (left_s := end_s - time.monotonic()) > 0.0:
            if socket.poll(int(left_s * 1e3) + 1):
                health = parse_health(socket.recv_multipart(), node)
                if health is not None:
                    return health
    return None


def parse_health(frames: Sequence[bytes], node: str) -> Mapping[str, Any] | None:
    """Return the node/health in the frames; None for invalid frames, and for nodes whose health the link forwards."""
    if len(frames) != 2 or frames[0] != TOPIC:
        return None
    try:
        health = msgpack.unpackb(frames[1])
    except (ValueError, msgpack.UnpackException):
        return None
    if not isinstance(health, dict) or health.get("src") != node:
        return None
    numbers = (health.get("rate_hz"), health.get("uptime_s"))
    complete = "state" in health and all(isinstance(number, float | int) for number in numbers)
    return health if complete else None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -P -m telenano.runtime.loop.healthcheck", description="Check whether a node is healthy."
    )
    named = os.environ.get(NODE_VARIABLE, "")
    parser.add_argument("node", nargs="?", default=named, metavar="NODE@SITE", help=f"default: {NODE_VARIABLE}")
    socket_folder = f"default: the socket NODE@SITE in {RUNTIME_DIRECTORY_VARIABLE}"
    parser.add_argument("--site-file", type=Path, help=f"address book of the rig (YAML); {socket_folder}")
    parser.add_argument("--within", type=float, default=DEFAULT_WITHIN_S, metavar="S", help="longest wait [s]")
    return parser


def _report(code: int, text: str) -> int:
    sys.stdout.write(text + "\n")
    return code


if __name__ == "__main__":
    sys.exit(main())

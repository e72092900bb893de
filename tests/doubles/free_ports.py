"""Ports that nobody has, apart in every process: tests run side by side."""

import contextlib
import itertools
import os
import socket

# below the ports that a system gives to clients
_PORTS = itertools.cycle(range(10_000 + 20 * (os.getpid() % 1000), 10_000 + 20 * (os.getpid() % 1000) + 2000))


def free_ports(count: int) -> list[int]:
    """Return ports that nobody has."""
    ports: list[int] = []
    while len(ports) < count:
        port = next(_PORTS)
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            ports.append(port)
    return ports

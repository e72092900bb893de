"""A test that waits for what another thread or process does, and the ports at which they are found."""

import contextlib
import itertools
import os
import socket
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
# Far beyond what is expected: it only keeps what is broken from holding up the suite.
PATIENCE_S = 30.0
# below the ports that a system gives to clients, and others in every process, because tests run side by side
_PORTS = itertools.cycle(range(10_000 + 20 * (os.getpid() % 1000), 10_000 + 20 * (os.getpid() % 1000) + 2000))


def until(condition: Callable[[], T], patience_s: float = PATIENCE_S) -> T:
    """Wait until something is true, and return it.

    Raises:
        TimeoutError: It was not within `patience_s`.
    """
    end = time.monotonic() + patience_s
    while not (value := condition()):
        if time.monotonic() > end:
            raise TimeoutError(f"waited in vain for {patience_s:g} s")
        time.sleep(0.005)
    return value


def free_ports(count: int) -> list[int]:
    """Return ports of this machine that nobody has."""
    ports: list[int] = []
    while len(ports) < count:
        port = next(_PORTS)
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            ports.append(port)
    return ports

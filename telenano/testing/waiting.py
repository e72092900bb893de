"""Functions for tests: wait for another thread or process, and find free ports."""

import contextlib
import itertools
import os
import socket
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
# Far longer than expected: it only keeps a broken test from blocking the suite [s].
PATIENCE_S = 30.0
# Below the ports that a system gives to clients, and different in every process, because tests run in parallel.
_PORTS = itertools.cycle(range(10_000 + 20 * (os.getpid() % 1000), 10_000 + 20 * (os.getpid() % 1000) + 2000))


def until(condition: Callable[[], T], patience_s: float = PATIENCE_S) -> T:
    """Wait until the value of `condition` is true, and return that value.

    Raises:
        TimeoutError: It was not true within `patience_s` [s].
    """
    end = time.monotonic() + patience_s
    while not (value := condition()):
        if time.monotonic() > end:
            raise TimeoutError(f"waited in vain for {patience_s:g} s")
        time.sleep(0.005)
    return value


def free_ports(count: int) -> list[int]:
    """Return this number of free TCP ports of this machine."""
    ports: list[int] = []
    while len(ports) < count:
        port = next(_PORTS)
        with socket.socket() as probe, contextlib.suppress(OSError):
            probe.bind(("127.0.0.1", port))
            ports.append(port)
    return ports

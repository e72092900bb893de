"""A test that waits for what another thread or process does."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")
# Far beyond what is expected: it only keeps what is broken from holding up the suite.
PATIENCE_S = 30.0


def until(condition: Callable[[], T]) -> T:
    """Wait until something is true, and return it."""
    end = time.monotonic() + PATIENCE_S
    while not (value := condition()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)
    return value

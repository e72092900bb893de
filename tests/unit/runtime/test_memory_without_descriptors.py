"""A process without a descriptor left."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager

from telenano.runtime.loop.machine import resident_bytes


@contextmanager
def room_for(descriptors: int) -> Iterator[None]:
    """Let this process open no more than a number of further files while the block runs."""
    before, lowest = resource.getrlimit(resource.RLIMIT_NOFILE), os.dup(0)
    os.close(lowest)
    resource.setrlimit(resource.RLIMIT_NOFILE, (lowest + descriptors, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


def test_a_node_without_a_descriptor_left_says_nothing_of_its_memory_and_goes_on() -> None:
    assert resident_bytes() > 0
    with room_for(0):
        assert resident_bytes() == 0

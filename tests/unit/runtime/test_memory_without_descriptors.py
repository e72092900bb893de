"""A process without a descriptor left."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from io import FileIO
from pathlib import Path

from telenano.runtime.loop.machine import resident_bytes
from telenano.runtime.loop.turn_limit import _SCHEDSTAT, _opened, waited_for_processor_s


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


def test_a_turn_that_waits_for_a_processor_is_known_to_wait_without_a_descriptor_left() -> None:
    schedstat = _opened(_SCHEDSTAT)
    assert schedstat is not None
    with schedstat:
        before_s = waited_for_processor_s(schedstat)
        with room_for(0):
            now_s = waited_for_processor_s(schedstat)
    assert before_s is not None and now_s is not None
    assert now_s >= before_s > 0.0


def test_a_file_of_the_kernel_that_is_gone_is_not_taken_for_no_wait(tmp_path: Path) -> None:
    (tmp_path / "schedstat").write_bytes(b"")
    with FileIO(tmp_path / "schedstat") as emptied:
        assert waited_for_processor_s(emptied) is None

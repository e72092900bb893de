"""A law in closed loop, for the tests of the laws."""

from collections.abc import Callable

import pytest

from telenano.testing import LawRun, run_law


@pytest.fixture
def run_loop() -> Callable[..., LawRun]:
    """Return `run_law`."""
    return run_law

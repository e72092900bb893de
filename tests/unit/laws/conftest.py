"""A law in closed loop, for the tests of the laws."""

from collections.abc import Callable

import pytest
from law_loop import Run, loop


@pytest.fixture
def run_loop() -> Callable[..., Run]:
    """Give `loop`."""
    return loop

"""A node on the bus of the fuzzer, for messages chosen by hand."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import fuzzed_nodes
import pytest


@pytest.fixture
def node_on_bus(tmp_path: Path) -> Iterator[Callable[[str], tuple[Any, Any]]]:
    """Give bus and loop of a node of `fuzzed_nodes.BUILD`."""
    with fuzzed_nodes.opened(tmp_path) as build:
        yield build

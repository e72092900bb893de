"""A bench for a node under test."""

import pytest

from telenano.testing import NodeBench


@pytest.fixture
def bench_of() -> type[NodeBench]:
    """Return the class of benches; call it with node@site."""
    return NodeBench

"""The recordings of the reference sessions."""

from collections.abc import Callable
from pathlib import Path

import pytest
from references import record

from telenano.testing import recording_with


@pytest.fixture(scope="session")
def reference_of(recordings_folder: Path) -> Callable[[str], Path]:
    """Return what records a reference session of `references.py` when it is first asked for in a test run.

    The file belongs to all tests: copy it before changing it.
    """
    return lambda name: recording_with(recordings_folder, name, lambda folder: record(name, folder))

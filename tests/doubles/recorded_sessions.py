"""Recordings of reference sessions, for the tests of the core and of packages that read them."""

import fcntl
import os
from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def recording_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Give the recording of a session of `tests/replay/references.py`, made when it is first asked for in a test run.

    `fig12_wave` and its like, for the other laws, are examples of two seconds. The file belongs to all tests: copy it
    before changing it.
    """
    base = tmp_path_factory.getbasetemp()
    # the workers of a run have folders of their own in one
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "recorded"
    folder.mkdir(exist_ok=True)

    def recorded(name: str) -> Path:
        from references import record

        path = folder / name / "session.mcap"
        with (folder / f"{name}.lock").open("w") as lock:
            # another worker may be making it
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                made = folder / f"{name}.made"
                record(name, made)
                made.rename(path.parent)
        return path

    return recorded

"""A worker of a test run that dies ends the run, which names its test and how it ended."""

import subprocess
import sys
from pathlib import Path

import pytest

DOUBLES = Path(__file__).parents[2] / "doubles"
DIES = """
import os, signal

def test_ends():
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.check("starts a run of its own")
def test_a_worker_that_dies_ends_the_run_with_its_test_and_its_signal(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text("from ended_workers import pytest_testnodedown\n")
    (tmp_path / "test_dies.py").write_text(DIES)
    (tmp_path / "pytest.ini").write_text(f"[pytest]\npythonpath = {DOUBLES}\n")
    makefile = (Path(__file__).parents[3] / "Makefile").read_text()
    (options,) = [line.partition(":=")[2].split() for line in makefile.splitlines() if line.startswith("SIDE_BY_SIDE")]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 1, done.stdout
    assert "ended with SIGKILL" in done.stdout
    # The test ran once, because no worker took the place of the one that died: each that did would fail in it, too.
    assert "crashed while running 'test_dies.py::test_ends'" in done.stdout
    assert "= 1 failed in " in done.stdout

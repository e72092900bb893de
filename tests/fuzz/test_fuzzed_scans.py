"""Whole small scans in simulated time, with parameters and maps at and beyond their ends, every index checked."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

FUZZ = Path(__file__).with_name("fuzz_scans.py")


@pytest.mark.endurance
def test_no_scan_looks_anything_up_beyond_its_tables_and_none_is_of_anything_but_numbers() -> None:
    root = str(FUZZ.parents[2])
    environment = {**os.environ, "NUMBA_BOUNDSCHECK": "1", "PYTHONPATH": root}
    done = subprocess.run(
        [sys.executable, str(FUZZ), "1000"],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    # a process that a signal ended has a negative code
    assert done.returncode == 0, f"{done.returncode}: {done.stdout}{done.stderr}"

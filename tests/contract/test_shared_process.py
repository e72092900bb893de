"""What a test file leaves in the process is gone for the next one: files share processes in an order of chance."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LEAVES = """
import gc, logging, signal
from telenano.wire.topics import TOPICS
from telenano.wire.codec import MOST_BYTES, _FORMS

FOUND = {"topics": TOPICS, "forms": _FORMS, "sizes": MOST_BYTES}

def found():
    root = logging.getLogger()
    tables = {name: list(table) for name, table in FOUND.items()}
    return {**tables, "log": root.level, "signal": signal.getsignal(signal.SIGUSR2), "collects": gc.isenabled()}

BEFORE = found()
"""
TESTS = """
from left import BEFORE, TOPICS, FOUND, found
import gc, logging, pytest, signal

@pytest.fixture(scope="module")
def row():
    TOPICS["wind/speed"] = TOPICS["afm/state"]

def test_it_finds_what_was_there_at_the_start():
    assert found() == BEFORE

def test_it_leaves_something(row):
    for table in FOUND.values():
        table["wind/gust"] = None
    signal.signal(signal.SIGUSR2, print)
    logging.getLogger().setLevel(1)
    gc.disable()
    assert found() != BEFORE

def test_it_finds_what_its_own_fixtures_made():
    assert found() == {**BEFORE, "topics": [*BEFORE["topics"], "wind/speed"]}
"""


@pytest.mark.check("starts pytest")
def test_no_test_finds_what_another_one_left(tmp_path: Path) -> None:
    (tmp_path / "left.py").write_text(LEAVES)
    files = [tmp_path / f"test_{name}.py" for name in ("first", "second")]
    for file in files:
        file.write_text(TESTS)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "restored_process", "-p", "no:cacheprovider"]
    command += ["-c", str(ROOT / "pyproject.toml"), "--rootdir", str(tmp_path), *map(str, files)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, (ROOT, ROOT / "tests" / "doubles")))}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "6 passed" in done.stdout, done.stdout + done.stderr

"""Benchmarks that still run: each explains itself, and those with a shortest run give figures that can be right."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[3] / "benchmarks"
SCRIPTS = sorted(path.name for path in FOLDER.glob("*.py") if "__main__" in path.read_text())
SMOKING = sorted(name for name in SCRIPTS if '"--smoke"' in (FOLDER / name).read_text())
# in one process, because most of the time goes into what they all import
ASK = """
import runpy, sys
sys.path.insert(0, sys.argv[1])
for name in sys.argv[2:]:
    sys.argv[:] = [name, "--help"]
    try:
        runpy.run_path(f"{sys.path[0]}/{name}", run_name="__main__")
    except SystemExit as end:
        assert not end.code, name
    else:
        raise AssertionError(f"{name} does not know --help")
"""


def test_every_script_explains_itself() -> None:
    done = subprocess.run([sys.executable, "-c", ASK, str(FOLDER), *SCRIPTS], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("usage: ") == len(SCRIPTS) >= 16


@pytest.mark.endurance
@pytest.mark.parametrize("name", SMOKING)
def test_the_shortest_run_gives_figures(name: str) -> None:
    command = [sys.executable, str(FOLDER / name), "--smoke", "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    figures = list(_numbers(json.loads(done.stdout.splitlines()[-1])))
    assert figures
    assert any(figure > 0.0 for figure in figures)


def test_a_shortest_run_is_there_for_what_was_broken_once() -> None:
    assert {"lockstep.py", "replay.py", "link.py", "network.py"} <= set(SMOKING)


def _numbers(value: object) -> list[float]:
    if isinstance(value, dict):
        return [number for part in value.values() for number in _numbers(part)]
    if isinstance(value, list):
        return [number for part in value for number in _numbers(part)]
    return [float(value)] if isinstance(value, int | float) else []

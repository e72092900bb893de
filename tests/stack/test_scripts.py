"""What a person starts by its path in this folder finds what it imports, without pytest."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
SCRIPTS = sorted(path.name for path in HERE.glob("*.py") if '\nif __name__ == "__main__":' in path.read_text("utf-8"))


@pytest.mark.check("takes a second each")
@pytest.mark.drawn(0.0, "tests/", "benchmarks/")
@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_finds_what_it_imports(name: str, tmp_path: Path) -> None:
    code = f"import runpy, sys; sys.path[0] = {str(HERE)!r}; runpy.run_path({str(HERE / name)!r}, run_name='script')"
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr

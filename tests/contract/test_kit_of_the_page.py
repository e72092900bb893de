"""The tests of telenano/testing/README.md pass as they stand there, in an empty folder and without a conftest."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "telenano" / "testing" / "README.md"
SECTION = PAGE.read_text(encoding="utf-8")
BLOCKS = {
    re.findall(r"def (test_\w+)", text)[0]: text for text in re.findall(r"```python\n(.*?)```", SECTION, re.DOTALL)
}


def test_the_page_has_a_test_with_each_part_of_the_kit() -> None:
    assert len(BLOCKS) == 5


@pytest.mark.check("records sessions and starts a rig of processes")
@pytest.mark.drawn(0.27, "telenano/testing/", "telenano/runtime/")
@pytest.mark.parametrize("name", BLOCKS)
def test_each_test_of_the_page_passes(name: str, tmp_path: Path) -> None:
    (tmp_path / "test_my_package.py").write_text(BLOCKS[name], encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_my_package.py"]
    environment = os.environ | {"TELENANO_RUNTIME_DIR": str(tmp_path / "run")}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "1 passed" in done.stdout

"""The worked example of force-curves.md: its commands run as they stand, and print what stands below them."""

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from telenano.cli.root import app

PAGE = Path(__file__).parents[3] / "packages" / "telenano-lab" / "docs" / "force-curves.md"
EXAMPLE = r"This example runs as it is printed.*?```sh\n(.*?)```\s+```text\n(.*?)```"


@pytest.mark.check("takes 1.7 s")
def test_the_worked_example_prints_what_the_document_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = re.search(EXAMPLE, PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    printed = ""
    for line in found[1].splitlines():
        result = CliRunner().invoke(app, shlex.split(line)[1:])
        assert result.exit_code == 0, result.output
        printed = result.output
    stated = dict(line.split() for line in found[2].splitlines())
    assert len(stated) == 4
    for name, value in stated.items():
        shown = re.search(rf"{re.escape(name)}\W+([-0-9.e]+)", printed)
        assert shown is not None, printed
        assert float(shown[1]) == pytest.approx(float(value), rel=1e-4, abs=0)

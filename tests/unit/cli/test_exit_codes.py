"""One kind of error has one exit code: each example of the table in docs/cli.md ends with the code of its row."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from telenano.cli.root import app

PAGE = (Path(__file__).parents[3] / "docs" / "cli.md").read_text(encoding="utf-8")
TABLE = PAGE.partition("<!-- kinds of errors -->")[2].partition("<!-- end of kinds -->")[0]
ROWS = re.findall(r"^\| (.+?) \| (\d) \| (.+) \|$", TABLE, re.MULTILINE)
EXAMPLES = [(kind, int(code), line) for kind, code, lines in ROWS for line in re.findall(r"`telenano ([^`]+)`", lines)]
# a name that is nearly right, and what was meant
MEANT = {
    "upp": "up",
    "up --scenrio fig12": "--scenario",
    "bridge foxglov": "foxglove",
    "up fig13": "fig12",
    "law show waves": "wave",
    "link profile ltee --show": "lte",
    "topic info haptic/stat": "haptic/state",
    "topic echo haptic/stat": "haptic/state",
    "device probe --device halpy": "haply",
    "node controler": "controller",
    "sample --sample dotz --out o": "dots",
    "scan --mode taping --out o": "tapping",
    "up fig12 --set controler.law=wave": "controller",
    "up fig12 --set controller.law=waves": "wave",
    "param list controler": "controller",
    "bag cat session.mcap --topics haptic/stat": "haptic/state",
    "bag plot session.mcap haptic/stat.x": "haptic/state",
}


def test_the_table_has_every_kind_and_each_of_both_codes() -> None:
    assert len(ROWS) >= 8
    assert {code for _, code, _ in EXAMPLES} == {1, 2}
    assert set(MEANT) <= {line for *_, line in EXAMPLES}


@pytest.mark.check("takes 1.1 s")
@pytest.mark.parametrize(("code", "line"), [(code, line) for _, code, line in EXAMPLES], ids=[e[2] for e in EXAMPLES])
def test_an_error_has_the_code_of_its_kind_and_is_one_sentence(
    code: int, line: str, make_file: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    shutil.copy(make_file(), folder / "session.mcap")
    for name, text in (("text.mcap", "no recording"), ("file", "in the way"), ("wrong.yaml", "name: [")):
        (folder / name).write_text(text)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("TELENANO_RUNTIME_DIR", str(tmp_path / "run"))
    done = CliRunner().invoke(app, line.split())
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    assert (done.exit_code, done.stdout) == (code, "")
    assert done.stderr.startswith("telenano: ")
    assert done.stderr.rstrip().count("\n") <= 1
    if line in MEANT:
        assert f"did you mean {MEANT[line]}?" in done.stderr

"""What the documents show is run as it stands there: notebooks, blocks of Python, and commands that need no rig."""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
PAGES = ("tutorial.md", "howto.md", "extending.md", "fit.md", "api.md", "instrument.md")
# those that need a rig, a device, another machine or minutes; their options are checked in test_documented_commands
ELSEWHERE = ("up", "session", "estop", "status", "view", "bridge", "link", "replay", "record", "device", "keys", "scan")
STUDIES = ("stability --law virtual_impedance",)

pytestmark = [pytest.mark.stack, pytest.mark.endurance]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sessions that the pages speak of."""
    folder = tmp_path_factory.mktemp("documents")
    for name, law in (("fig12", "virtual_impedance"), ("delay/0", "virtual_impedance"), ("delay/40", "wave")):
        (folder / "out" / name).mkdir(parents=True)
        shutil.copy(ROOT / "tests" / "replay" / f"{law}.mcap", folder / "out" / name / "session.mcap")
    return folder


def run(command: list[str], place: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg"}
    return subprocess.run(command, env=environment, cwd=place, capture_output=True, text=True, timeout=900)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_from_its_first_cell_to_its_last(path: Path, place: Path) -> None:
    assert len(NOTEBOOKS) == 3
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert all(not cell.get("outputs") for cell in cells), "outputs are made by running it"
    done = run([sys.executable, "-c", "\n".join(code)], place)
    assert done.returncode == 0, done.stderr


def blocks(page: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", (DOCS / page).read_text(), re.DOTALL | re.MULTILINE)


def python_blocks() -> Iterator[tuple[str, str]]:
    for page in PAGES:
        for block in blocks(page, "python"):
            # a running rig, and a package that is not among the dependencies
            if "telenano.live()" not in block and "rerun" not in block:
                yield page, block


@pytest.mark.parametrize(("page", "block"), list(python_blocks()), ids=lambda part: part.strip().splitlines()[-1][:40])
def test_a_block_of_python_runs(page: str, block: str, place: Path) -> None:
    done = run([sys.executable, "-c", block], place)
    assert done.returncode == 0, done.stderr


def commands() -> Iterator[tuple[str, str]]:
    for page in PAGES:
        for block in blocks(page, "sh"):
            for line in block.splitlines():
                words = shlex.split(line, comments=True)
                if words[:1] == ["telenano"] and words[1] not in ELSEWHERE and "my_law" not in words:
                    yield page, line
        for line in re.findall(r"`(telenano [^`]+)`", (DOCS / page).read_text()):
            words = shlex.split(line)
            if (
                words[1] in ("bag", "report", "compare", "scenario", "param", "graph")
                and "out/fig12/session.mcap" in words
            ):
                yield page, line


@pytest.mark.parametrize(("page", "line"), list(dict.fromkeys(commands())), ids=lambda part: part[:60])
def test_a_command_that_needs_no_rig_does_what_it_says(page: str, line: str, place: Path) -> None:
    words = shlex.split(line, comments=True)[1:]
    expanded = [str(path) for word in words for path in (sorted(place.glob(word)) if "*" in word else [word])]
    if words[0] == "study" and not any(name in line for name in STUDIES):
        pytest.skip("takes minutes; its options are checked in test_documented_commands")
    if words[:2] == ["scenario", "new"]:
        (place / f"{words[2]}.yaml").unlink(missing_ok=True)
    done = run([sys.executable, "-m", "telenano", *expanded], place)
    # 3: the references are parts of sessions, which report and compare say
    assert done.returncode in (0, 3), done.stderr
    if "--out" in expanded:
        assert (place / expanded[expanded.index("--out") + 1]).exists()

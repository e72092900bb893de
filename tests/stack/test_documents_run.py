"""What the documents show is run as it stands there: notebooks, Python, commands, rigs and what runs beside them."""

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
from stack_rig import Rig

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
PAGES = ("../README.md", "tutorial.md", "howto.md", "extending.md", "fit.md", "api.md", "instrument.md", "paper.md")
# what runs beside a rig, each for a moment where it would not end by itself
BESIDE = {
    "session": (), "estop": (), "status": (), "link": (), "topic": (), "bridge": ("--duration", "1", "--port", "8799"),
}  # fmt: skip
# those that need a rig, a device, another machine or minutes; their options are checked in test_documented_commands
ELSEWHERE = ("up", *BESIDE, "view", "replay", "record", "device", "keys", "scan")
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
    # socket paths are short by law, pytest's folders are not
    sockets = f"/tmp/tn-{os.getpid()}-documents"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg", "TELENANO_RUNTIME_DIR": sockets}
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


def in_blocks(page: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the command lines in the blocks of a page, each with its arguments."""
    for block in blocks(page, "sh"):
        for line in block.splitlines():
            words = shlex.split(line, comments=True)
            # "telenano new … && pip install …" is what test_packages does
            if words and Path(words[0]).name == "telenano" and "&&" not in words:
                yield line, words[1:]


def in_sentences(page: str) -> Iterator[tuple[str, list[str]]]:
    for line in re.findall(r"`(telenano [^`]+)`", (DOCS / page).read_text()):
        yield line, shlex.split(line)[1:]


def commands() -> Iterator[tuple[str, str]]:
    for page in PAGES:
        for line, words in in_blocks(page):
            if words[0] not in ELSEWHERE and not {"my_law", "my_points.csv", "--live"} & set(words):
                yield page, line
        for line, words in in_sentences(page):
            if "out/fig12/session.mcap" in words and words[0] in ("bag", "report", "compare", "scenario", "param"):
                yield page, line


@pytest.mark.parametrize(("page", "line"), list(dict.fromkeys(commands())), ids=lambda part: part[:60])
def test_a_command_that_needs_no_rig_does_what_it_says(page: str, line: str, place: Path) -> None:
    words = shlex.split(line, comments=True)[1:]
    # as many pages make the same file, and nothing is overwritten
    shutil.rmtree(place / "fig12-json.mcap", ignore_errors=True)
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


def test_the_edges_of_the_tutorial_are_where_it_says(place: Path) -> None:
    (words,) = [words for _, words in in_blocks("tutorial.md") if words[:2] == ["study", "stability"]]
    done = run([sys.executable, "-m", "telenano", *words, "--json", "--out", "edges"], place)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)["critical_delay_ms"]
    text = (DOCS / "tutorial.md").read_text()
    stated = re.findall(r"(\d+) N/m (?:the loop bears|only) ([0-9.]+) ms", text)
    assert len(stated) == 2
    assert [f"{found[stiffness]:.1f}" for stiffness, _ in stated] == [delay_ms for _, delay_ms in stated]


def beside_a_rig() -> list[list[str]]:
    found = [
        words
        for page in PAGES[:3]
        for _, words in (*in_blocks(page), *in_sentences(page))
        if words and words[0] in BESIDE and words[1:2] != ["arm"]
    ]
    # whatever else stops and goes on again at the end
    return sorted((words for words in found if "…" not in " ".join(words)), key=lambda words: words[0] == "estop")


def test_commands_beside_a_rig_do_what_they_say(rig: Rig) -> None:
    rig.start("--duration", "90")
    rig.wait_until(rig.running, "the session")
    ran = []
    for words in beside_a_rig():
        done = rig.telenano(*words, *BESIDE[words[0]])
        assert done.returncode == 0, (words, done.stderr)
        ran.append(words[0])
    assert {"session", "estop", "status", "link", "topic"} <= set(ran)

    def hand() -> dict[str, object]:
        done = rig.telenano("topic", "echo", "haptic/state", "--count", "1", "--json")
        assert done.returncode == 0, done.stderr
        found: dict[str, object] = json.loads(done.stdout)["messages"][0]
        return found.get("message", found)  # type: ignore[return-value]

    # the README: everything stops, until `telenano session arm`
    assert hand()["estop"] is True
    assert rig.telenano("session", "arm").returncode == 0
    rig.wait_until(lambda: hand()["estop"] is False, "the hand to be armed")
    shown = json.loads(rig.telenano("link", "show", "--json").stdout)
    assert "0.2" in json.dumps(shown["forward"])
    assert shown["forward"] != shown["backward"]
    _, summary, _ = rig.stop()
    assert summary["law"] == ["virtual_impedance", "passivity"]


def rigs() -> list[tuple[str, tuple[str, ...]]]:
    """Return the sessions of the pages that test_fig12 does not run, and that need no package of the reader's."""
    found = []
    for page in PAGES:
        for _, words in in_blocks(page):
            known = any(part in words for part in ("60", "40", "--site", "--sweep", "touch", "image", "fig10"))
            if words[0] == "up" and not known and not any("my_" in word or "soft_gel" in word for word in words):
                found.append((page, tuple(words[1:])))
    return list(dict.fromkeys(found))


@pytest.mark.parametrize(("page", "arguments"), rigs(), ids=lambda part: part if isinstance(part, str) else "")
def test_a_session_of_a_page_runs(page: str, arguments: tuple[str, ...], rig: Rig) -> None:
    command = [*arguments, "--duration", "2.5", "--json"]
    if "--out" not in command:
        command += ["--out", str(rig.out)]
    done = subprocess.run(
        rig.command("up", *command), env=rig.environment, cwd=ROOT, capture_output=True, text=True, timeout=140
    )
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    # the operator's programme ran, and the tip was measured all the while
    assert summary["duration_s"] > 2.0
    assert summary["completeness"]["afm/state"] > 0.5


def test_laws_of_the_tutorial_hold_the_contact_where_the_papers_does_not(rig: Rig) -> None:
    (words,) = [
        words
        for _, words in in_blocks("tutorial.md")
        if words[0] == "up" and any("controller.law=" in w for w in words)
    ]
    words[words.index("--out") + 1] = str(rig.out)
    command = rig.command(*words, "--duration", "4.7", "--json")
    done = subprocess.run(command, env=rig.environment, cwd=ROOT, capture_output=True, text=True, timeout=290)
    assert done.returncode == 0, done.stderr
    verdicts = {row["law"]: row["verdict"] for row in json.loads(done.stdout)["sessions"]}
    assert verdicts.pop("virtual_impedance") != "stable"
    assert verdicts == {"wave": "stable", "passivity": "stable"}

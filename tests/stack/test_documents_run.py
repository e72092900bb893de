"""What the documents show is run as it stands there: notebooks, Python, commands, rigs and what runs beside them."""

import contextlib
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import msgpack
import pytest
from experiment_tables import demo
from stack_rig import Rig
from websockets.sync.client import connect

from recording.reader import Recording
from services.viz_node.requests import PROTOCOL
from services.viz_node.serve import missing_for_view
from studies.experiments.table import tidy, write_tables

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))
PAGES = ("../README.md", "tutorial.md", "howto.md", "extending.md", "fit.md", "api.md", "instrument.md", "paper.md")
# what runs beside a rig, each for a moment where it would not end by itself
BESIDE = {
    "session": (), "estop": (), "status": (), "link": (), "topic": (), "bridge": ("--duration", "1", "--port", "8799"),
}  # fmt: skip
# those that need a rig, a device or another machine: most of them are run further down, and in test_live_programs
ELSEWHERE = ("up", *BESIDE, "view", "replay", "record", "device", "keys", "scan")
# the studies of the README take minutes of both processors
LONGEST_S = 1500
# far beyond what is expected: only keeps what does not end from holding the suite
PATIENCE_S = 60.0
README = "../README.md"

pytestmark = [pytest.mark.stack, pytest.mark.endurance]


@pytest.fixture(scope="module")
def place(recording_of: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sessions that the pages speak of."""
    folder = tmp_path_factory.mktemp("documents")
    for name, law in (("fig12", "virtual_impedance"), ("delay/0", "virtual_impedance"), ("delay/40", "wave")):
        (folder / "out" / name).mkdir(parents=True)
        shutil.copy(recording_of(f"fig12_{law}"), folder / "out" / name / "session.mcap")
    (folder / "out" / "experiment" / "analysis").mkdir(parents=True)
    write_tables(tidy(demo(1)), folder / "out" / "experiment" / "analysis")
    return folder


def environment_of() -> dict[str, str]:
    # socket paths are short by law, pytest's folders are not
    sockets = f"/tmp/tn-{os.getpid()}-documents"
    return {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg", "TELENANO_RUNTIME_DIR": sockets}


def run(command: list[str], place: Path, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    environment = environment or environment_of()
    return subprocess.run(command, env=environment, cwd=place, capture_output=True, text=True, timeout=LONGEST_S - 60)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_from_its_first_cell_to_its_last(path: Path, place: Path) -> None:
    assert len(NOTEBOOKS) == 4
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
        for line in block.replace("\\\n", " ").splitlines():
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
            alone = page in PAGES[:3] and words[0] in ("param", "study")
            if alone or ("out/fig12/session.mcap" in words and words[0] in ("bag", "report", "compare")):
                yield page, line


@pytest.mark.timeout(LONGEST_S)
@pytest.mark.parametrize(("page", "line"), list(dict.fromkeys(commands())), ids=lambda part: part[:60])
def test_a_command_that_needs_no_rig_does_what_it_says(page: str, line: str, place: Path) -> None:
    words = shlex.split(line, comments=True)[1:]
    # as many pages make the same file, and nothing is overwritten
    shutil.rmtree(place / "fig12-json.mcap", ignore_errors=True)
    expanded = [str(path) for word in words for path in (sorted(place.glob(word)) if "*" in word else [word])]
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
    stated = re.findall(r"(\d+) N/m (?:the loop tolerates|only) ([0-9.]+) ms", text)
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
    (block,) = [text for text in blocks("api.md", "python") if "telenano.live()" in text]
    environment = {**environment_of(), "TELENANO_RUNTIME_DIR": str(rig.sockets)}
    # a second of messages will do
    done = run([sys.executable, "-c", block.replace("duration_s=5.0", "duration_s=1.0")], rig.folder, environment)
    assert done.returncode == 0, done.stderr
    assert "haptic/state" in done.stdout

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
    """Return the sessions of the pages that no other test runs, and that need no package of the reader's."""
    found = []
    for page in PAGES:
        for _, words in in_blocks(page):
            known = any(part in words for part in ("60", "40", "--site", "--sweep", "image", "fig10"))
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


def line_of(page: str, beginning: str) -> list[str]:
    """Return the words of the one command of a page that begins so, without `telenano`."""
    (words,) = [words for _, words in in_blocks(page) if " ".join(words).startswith(beginning)]
    return words


@contextlib.contextmanager
def started(command: list[str], environment: dict[str, str], place: Path) -> Iterator["subprocess.Popen[str]"]:
    """A process in the background, which Ctrl-C ends as a person would end it, with code 0."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, env=environment, cwd=place, stdout=pipe, stderr=pipe, text=True)
    try:
        yield process
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == 0, err
    finally:
        process.kill()
        process.communicate()


@pytest.mark.skipif(bool(missing_for_view()), reason=missing_for_view() or "the page is there")
def test_the_page_of_the_recording_of_the_readme_is_served(place: Path) -> None:
    command = [sys.executable, "-m", "telenano", *line_of(README, "view "), "--port", "0"]
    with started(command, environment_of(), place) as process:
        assert process.stdout is not None
        # the token is not written to a pipe: the second line names the file that has it
        file = Path([process.stdout.readline() for _ in range(2)][-1].split()[-1])
        address, _, token = file.read_text().split()[1].partition("#")
        bare = address.partition("//")[2].strip("/")
        with connect(f"ws://{bare}/bus", origin=f"http://{bare}") as page:  # type: ignore[arg-type]
            page.send(msgpack.packb({"k": "hello", "token": token, "protocol": PROTOCOL}))
            shown = msgpack.unpackb(page.recv(timeout=PATIENCE_S))
            # it plays
            while msgpack.unpackb(page.recv(timeout=PATIENCE_S))["k"] != "tick":
                pass
    assert shown["k"] == "snapshot"
    assert shown["source"]["kind"] == "recording"


def test_the_hand_of_a_recording_is_replayed_into_the_rig_that_the_readme_names(rig: Rig, place: Path) -> None:
    ((line, words),) = [found for found in in_blocks(README) if found[1][0] == "replay"]
    without = shlex.split(line.partition("started with")[2])
    assert without[0] == "--without"
    rig.start(*without, "--duration", "3")
    rig.wait_until(lambda: rig.log_has("controller@master", "ready"), "a rig that waits for its hand")
    environment = {**environment_of(), "TELENANO_RUNTIME_DIR": str(rig.sockets)}
    with started([sys.executable, "-m", "telenano", *words], environment, place):
        code, _, err = rig.finish()
    assert code in (0, 3), err
    recorded = Recording(place / words[1])
    played = Recording(rig.out / "session.mcap")
    hand = [[message.payload for message in one.messages(["haptic/state"])] for one in (recorded, played)]
    # the very bytes of the recorded hand, and a law and an instrument that are live
    assert len(hand[1]) > 1000
    assert set(hand[1]) <= set(hand[0])
    assert len(list(played.messages(["afm/state"]))) > 1000


def shell(line: str, environment: dict[str, str], place: Path) -> subprocess.CompletedProcess[str]:
    """Run a line of a page as a shell does, which knows ~ and &&."""
    return run(["bash", "-ec", line], place, environment)


def test_two_sites_of_the_readme_run_on_one_machine_as_the_page_of_deployment_says(rig: Rig, tmp_path: Path) -> None:
    (block,) = [text for text in blocks("deployment.md", "sh") if "~/.config/telenano" in text]
    shims = tmp_path / "bin"
    shims.mkdir()
    (shims / "telenano").write_text(f'#!/bin/sh\nexec {sys.executable} -m telenano "$@"\n')
    (shims / "telenano").chmod(0o755)
    environment = {**environment_of(), "HOME": str(tmp_path), "TELENANO_RUNTIME_DIR": str(rig.sockets)}
    environment["PATH"] = f"{shims}{os.pathsep}{environment['PATH']}"
    for name in ("TELENANO_KEYS_DIR", "XDG_CONFIG_HOME", "TELENANO_HOST_MASTER", "TELENANO_HOST_SLAVE"):
        environment.pop(name, None)
    sites = {}
    for line in block.splitlines():
        words = shlex.split(line, comments=True)
        if words[1:3] == ["up", "--site"]:
            sites[words[3]] = words[1:]
        else:
            done = shell(line, environment, tmp_path)
            assert done.returncode == 0, (line, done.stderr)
    for site, words in sites.items():
        assert words[: words.index("--out")] == line_of(README, f"up --site {site}")
    command = [sys.executable, "-m", "telenano"]
    with started([*command, *sites["slave"]], environment, tmp_path):
        done = subprocess.run(
            [*command, *sites["master"], "--duration", "3", "--json"],
            env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=140,
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert summary["completeness"]["teleop/backward@master"] > 0.5
    # each side has a recording of its own
    for site in ("master", "slave"):
        assert (tmp_path / "out" / site / "session.mcap").stat().st_size > 0


@pytest.mark.timeout(LONGEST_S)
def test_a_law_of_ones_own_is_made_installed_and_run_by_the_letter(rig: Rig, tmp_path: Path) -> None:
    # the README's own .venv, with what is installed here beneath
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(tmp_path / ".venv")], check=True, timeout=120)
    commands, (site,) = tmp_path / ".venv" / "bin", (tmp_path / ".venv" / "lib").glob("python*/site-packages")
    (site / "tests.pth").write_text("\n".join((str(ROOT), *(path for path in sys.path if "site-packages" in path))))
    for name in ("telenano", "pip"):
        (commands / name).write_text(f'#!/bin/sh\nexec "{commands}/python" -m {name} "$@"\n')
        (commands / name).chmod(0o755)
    # no index is asked: everything that the package needs is here
    quiet = {"PIP_NO_INDEX": "1", "PIP_NO_BUILD_ISOLATION": "0", "PIP_NO_DEPS": "1", "PIP_QUIET": "1"}
    environment = {**os.environ, **quiet, "MPLBACKEND": "agg", "TELENANO_RUNTIME_DIR": str(rig.sockets)}
    environment.pop("PYTHONPATH", None)
    environment["PATH"] = f"{commands}{os.pathsep}{environment['PATH']}"
    first = [line for block in blocks(README, "sh") for line in block.splitlines() if "my_law" in line]
    (block,) = [text for text in blocks("extending.md", "sh") if "pip install -e telenano-my-law" in text]
    # the first two lines of the block are those of the README
    printed = {}
    for line in (*first, *block.splitlines()[2:]):
        text = line.partition("#")[0].strip()
        done = shell(f"{text} --duration 2.5 --json" if "telenano up" in text else text, environment, tmp_path)
        assert done.returncode == 0, (line, done.stderr)
        printed[" ".join(text.split()[1:3])] = done.stdout
    assert json.loads(printed["up --scenario"])["law"] == ["my_law"]
    assert "telenano-my-law" in printed["law list"]
    assert (tmp_path / "out" / "my_law" / "stability.html").exists()

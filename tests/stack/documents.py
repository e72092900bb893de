"""How the tests of the documents run what is in them: in a folder with the sessions that the pages speak of."""

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from documented_lines import Line, lines, makes
from telenano_lab.doubles.made_journals import demo
from telenano_lab.experiments.folder_tables import describe
from telenano_lab.experiments.table import tidy, write_tables

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
HOWTO = "docs/howto.md"
# the studies of a page take minutes of both processors
LONGEST_S = 1500
# far beyond what is expected: only keeps what does not end from holding the suite
PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def place(recording_of: Callable[[str], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sessions that the pages speak of."""
    folder = tmp_path_factory.mktemp("documents")
    for name, law in (("fig12", "virtual_impedance"), ("delay/0", "virtual_impedance"), ("delay/40", "wave")):
        (folder / "out" / name).mkdir(parents=True)
        shutil.copy(recording_of(law), folder / "out" / name / "session.mcap")
    session = (folder / "out" / "fig12" / "session.mcap").read_bytes()
    for name in ("s", "session"):
        (folder / f"{name}.mcap").write_bytes(session)
    for name in ("killed", "session_1"):
        (folder / f"{name}.mcap").write_bytes(session[: len(session) // 2])
    (folder / "examples").mkdir()
    shutil.copy(ROOT / "examples" / "force_curve.txt", folder / "examples")
    (folder / "out" / "experiment" / "analysis").mkdir(parents=True)
    write_tables(tidy(demo(1), describe), folder / "out" / "experiment" / "analysis")
    return folder


def environment_of() -> dict[str, str]:
    # socket paths are short by law, pytest's folders are not
    sockets = f"/tmp/tn-{os.getpid()}-documents"
    return {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "agg", "TELENANO_RUNTIME_DIR": sockets}


def run(command: list[str], place: Path, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    environment = environment or environment_of()
    return subprocess.run(command, env=environment, cwd=place, capture_output=True, text=True, timeout=LONGEST_S - 60)


def shims(folder: Path, **others: str) -> dict[str, str]:
    """Return an environment in which a shell finds `telenano`, and other commands with a text of their own."""
    folder.mkdir()
    for name, text in {"telenano": f'exec {sys.executable} -m telenano "$@"', **others}.items():
        (folder / name).write_text(f"#!/bin/sh\n{text}\n")
        (folder / name).chmod(0o755)
    environment = environment_of()
    return {**environment, "PATH": f"{folder}{os.pathsep}{environment['PATH']}"}


def shell(line: str, environment: dict[str, str], place: Path) -> subprocess.CompletedProcess[str]:
    """Run a line of a page as a shell does, which knows ~ and &&."""
    return run(["bash", "-ec", line], place, environment)


def expanded(words: list[str], place: Path) -> list[str]:
    return [str(path) for word in words for path in (sorted(place.glob(word)) if "*" in word else [word])]


def prepare(line: Line, place: Path) -> None:
    """Make what a line reads, and earlier lines of its page write."""
    before = [other for other in lines() if other.page == line.page][: lines_of(line.page).index(line)]
    for name in re.findall(r"[\w/-][\w./-]*\.(?:npz|h5|gsf|yaml)\b", line.text):
        maker = next((other for other in before if makes(other, name)), None)
        if maker is None or (place / name).exists():
            continue
        prepare(maker, place)
        command = ["-c", maker.text] if maker.language == "python" else ["-m", "telenano", *maker.words]
        done = run([sys.executable, *command], place)
        assert done.returncode == 0, done.stderr


def lines_of(page: str) -> list[Line]:
    return [line for line in lines() if line.page == page]


def once(found: list[Line]) -> list[Line]:
    """Return each command once, wherever pages have its results put."""
    unlike = {}
    for line in found:
        words = line.words
        place = words.index("--out") if "--out" in words else len(words)
        unlike.setdefault((*words[:place], *words[place + 2 :]), line)
    return list(unlike.values())


def named(part: object) -> str:
    return f"{part.page}: {part.text.strip().splitlines()[-1][:60]}" if isinstance(part, Line) else str(part)


def block_of(page: str, part: str) -> list[Line]:
    """Return the lines of the one block of a page in which a line has a text."""
    (number,) = {line.block for line in lines_of(page) if part in line.text}
    return [line for line in lines_of(page) if line.block == number]


def line_of(page: str, beginning: str) -> list[str]:
    """Return the words of the one command of a page that begins so, without `telenano`."""
    (found,) = [line.words for line in lines_of(page) if " ".join(line.words).startswith(beginning)]
    return found


@contextlib.contextmanager
def started(
    command: list[str], environment: dict[str, str], place: Path, code: int = 0
) -> Iterator["subprocess.Popen[str]"]:
    """A process in the background, which Ctrl-C ends as a person would end it, with a code."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(command, env=environment, cwd=place, stdout=pipe, stderr=pipe, text=True)
    try:
        yield process
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=PATIENCE_S)
        assert process.returncode == code, err
    finally:
        process.kill()
        process.communicate()

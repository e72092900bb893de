import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.signals import children

ROOT = Path(__file__).parents[3]
# Tests start programs as users do. The page is built, and a release is tried, where the project is not installed.
APART = (
    "tests/",
    "services/signals/children.py",
    "services/viz_node/build_page.py",
    "deploy/release.py",
)
STARTS = {
    "subprocess": {"Popen", "run", "call", "check_call", "check_output", "getoutput", "getstatusoutput"},
    "os": {"system", "popen", "fork", "forkpty", "posix_spawn", "posix_spawnp"},
    "asyncio": {"create_subprocess_exec", "create_subprocess_shell"},
    "pty": {"spawn", "fork"},
    "runpy": {"run_module"},
}
FOREIGN = ("recording.py", "numpy.py", "proto.py", "socket.py", "pickle.py", "json.py", "services.py")
SHOWS_PATH = "import os, sys; print(sys.path[0], os.environ['PYTHONSAFEPATH'], sys.flags.safe_path)"


def sources() -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [ROOT / name for name in listed.splitlines() if not name.startswith(APART) and "/tests/" not in name]


def calls(tree: ast.AST) -> Iterator[tuple[str, str, int]]:
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and isinstance(node.func.value, ast.Name)
        ):
            yield node.func.value.id, node.func.attr, node.lineno
        elif isinstance(node, ast.ImportFrom) and node.module in STARTS:
            yield from ((node.module, alias.name, node.lineno) for alias in node.names)


def starts_in(text: str) -> list[int]:
    # parsing takes long, and most files name nothing of the kind
    if not re.search(r"subprocess|asyncio|pty|runpy|multiprocessing|concurrent|import os|from os", text):
        return []
    tree = ast.parse(text)
    found = [
        line
        for module, name, line in calls(tree)
        if name in STARTS.get(module, ()) or (module == "os" and re.match(r"exec|spawn", name))
    ]
    # workers are spawned in a way of their own
    spawns = re.search(r"get_context\(\"spawn\"\)|ProcessPoolExecutor\(|multiprocessing\.(Process|Pool)\(", text)
    if spawns and "safe_path()" not in text:
        found.append(text[: spawns.start()].count("\n") + 1)
    return found


@pytest.mark.parametrize(
    "text",
    [
        "import subprocess\nsubprocess.run(['ls'])",
        "from subprocess import Popen",
        "import os\nos.execv('a', ['a'])",
        "import os\nos.spawnlp(0, 'a')",
        "import asyncio\nasyncio.create_subprocess_exec('a')",
        'from multiprocessing import get_context\nget_context("spawn").Process()',
        "from concurrent.futures import ProcessPoolExecutor\nProcessPoolExecutor(2)",
    ],
)
def test_a_start_of_a_process_is_seen(text: str) -> None:
    assert starts_in(text)


def test_one_function_starts_every_process() -> None:
    found = {f"{path.relative_to(ROOT)}:{line}" for path in sources() for line in starts_in(path.read_text())}
    assert not found, f"start it by services.signals.children: {sorted(found)}"


def test_shells_images_and_units_start_python_with_a_safe_path() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    names = [name for name in listed.splitlines() if name.startswith("deploy/") or name == "Makefile"]
    names = [name for name in names if not name.endswith((".py", ".lock", ".md"))]
    assert {"Makefile", "deploy/Dockerfile", "deploy/docker-compose.yml", "deploy/telenano-relay.service"} <= set(names)
    unsafe = re.compile(r"(BIN\)/|[\"\s/])python3?\"?,?\s+\"?-[mc]\b")
    assert unsafe.search('CMD ["python", "-m", "x"]') and unsafe.search("\t$(BIN)/python -c x")
    found = {name: unsafe.findall((ROOT / name).read_text().replace("python3 -m http.server", "")) for name in names}
    assert not any(found.values()), found
    assert "PYTHONSAFEPATH=1" in (ROOT / "deploy/Dockerfile").read_text()
    for unit in (name for name in names if name.endswith(".service")):
        assert "PYTHONSAFEPATH=1" in (ROOT / unit).read_text()


def said_by(code: str) -> list[str]:
    return str(children.run([sys.executable, "-c", code], capture_output=True, text=True).stdout).split()[1:]


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in FOREIGN:
        (tmp_path / name).write_text("raise SystemExit('a file of the folder was run')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    return tmp_path


@pytest.mark.usefixtures("foreign")
def test_a_python_that_is_started_imports_nothing_of_the_folder() -> None:
    for environment in (None, dict(os.environ)):
        done = children.run(
            [sys.executable, "-c", f"import recording, proto; {SHOWS_PATH}"],
            capture_output=True, text=True, env=environment,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert done.stdout.split()[1:] == ["1", "True"]
    # What another program starts in turn has it from the environment.
    inner = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {SHOWS_PATH!r}], check=True)"
    assert children.run([sys.executable, "-c", inner], capture_output=True, text=True).stdout.split()[1:] == [
        "1",
        "True",
    ]


@pytest.mark.parametrize("safe", [True, False])
def test_workers_import_nothing_of_the_folder(safe: bool, foreign: Path) -> None:
    block = "children.safe_path()" if safe else "contextlib.nullcontext()"
    code = (
        "import contextlib, os, sys\n"
        "from concurrent.futures import ProcessPoolExecutor\n"
        "from multiprocessing import get_context\n"
        "from services.signals import children\n"
        "if __name__ == '__main__':\n"
        f"    with {block}, ProcessPoolExecutor(1, get_context('spawn')) as pool:\n"
        "        print(pool.submit(abs, -7).result())\n"
        "    print('PYTHONSAFEPATH' in os.environ)\n"
    )
    # This program is started as a console script is: its own path is safe, and no flag of it says so to its workers.
    script = foreign / "bin" / "script.py"
    script.parent.mkdir()
    script.write_text(code)
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True)
    assert (done.returncode == 0 and done.stdout.split() == ["7", "False"]) is safe, done.stderr


def test_a_process_takes_the_place_of_this_one_with_a_safe_path() -> None:
    code = f"import sys; from services.signals import children; children.become([sys.executable, '-c', {SHOWS_PATH!r}])"
    assert children.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.split()[1:] == [
        "1",
        "True",
    ]

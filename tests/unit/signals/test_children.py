import ast
import contextlib
import importlib.util
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from telenano_devices.impedance.servo_process import ProcessLink
from telenano_lab.experiments.apparatus.rig_process import RigError, RigProcess
from telenano_lab.networks import measured_lines
from telenano_laws import live_sessions

from telenano.cli.child_session import run_session
from telenano.cli.commands.node import node as run_node
from telenano.extend.hands import DeviceError
from telenano.files.limited_child import read_in_child
from telenano.launcher.fan_out import fan_out
from telenano.launcher.processes import NodeProcesses
from telenano.runtime.bus.local_endpoint import fan_out_endpoint, is_bound
from telenano.signals import children

ROOT = Path(__file__).parents[3]
# Tests and examples start programs as users do. The page is built where the project is not installed.
# A test starts a process as a person does, and the kit for tests is of their kind.
APART = (
    "tests/",
    "examples/",
    "telenano/testing/",
    "telenano/signals/children.py",
    "services/viz_node/build_page.py",
)
STARTS = {
    "subprocess": {"Popen", "run", "call", "check_call", "check_output", "getoutput", "getstatusoutput"},
    "os": {"system", "popen", "fork", "forkpty", "posix_spawn", "posix_spawnp"},
    "asyncio": {"create_subprocess_exec", "create_subprocess_shell"},
    "pty": {"spawn", "fork"},
    "runpy": {"run_module"},
}
FOREIGN = (
    "recording", "numpy", "proto", "services", "telenano", "asyncio", "zmq", "socket", "pickle", "json", "signal",
    "threading", "warnings",
)  # fmt: skip
SHOWS_PATH = "import os, sys; print(sys.path[0], os.environ['PYTHONSAFEPATH'], sys.flags.safe_path)"


def sources() -> list[Path]:
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    names = [name for name in listed.splitlines() if not name.startswith(APART)]
    return [ROOT / name for name in names if not {"tests", "doubles"} & {*Path(name).parts}]


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
    # workers are spawned in a way of their own, and with the pool already the process that tracks its semaphores
    spawns = re.search(r"get_context\(\"spawn\"\)|multiprocessing\.(Process|Pool)\(", text)
    if spawns and "spawning_workers()" not in text:
        found.append(text[: spawns.start()].count("\n") + 1)
    blocks = [each for each in ast.walk(tree) if isinstance(each, ast.With)]
    safe = [each for each in blocks if any("spawning_workers()" in ast.unparse(item) for item in each.items)]
    within = {id(part) for block in safe for part in ast.walk(block)}
    found += [
        each.lineno
        for each in ast.walk(tree)
        if isinstance(each, ast.Call)
        and ast.unparse(each.func).endswith("ProcessPoolExecutor")
        and id(each) not in within
    ]
    return found


def uses_children(path: Path) -> bool:
    """Whether a file of the core or of a package starts a process by `children`."""
    by_module = r"\bchildren\.(start|run|become|spawning_workers|in_processes)\("
    by_face = r"^ *from telenano\.signals import .*\b(start|run|in_processes)\b"
    return bool(re.search(f"{by_module}|{by_face}", path.read_text(), re.MULTILINE))


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
        "pool = ProcessPoolExecutor(2)  # concurrent\nwith children.spawning_workers():\n    pool.submit(abs, 1)",
    ],
)
def test_a_start_of_a_process_is_seen(text: str) -> None:
    assert starts_in(text)


@pytest.mark.check("takes 1.7 s")
def test_one_function_starts_every_process() -> None:
    found = {f"{path.relative_to(ROOT)}:{line}" for path in sources() for line in starts_in(path.read_text())}
    assert not found, f"start it by telenano.signals.children: {sorted(found)}"


def test_shells_images_and_units_start_python_with_a_safe_path() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    names = [name for name in listed.splitlines() if name.startswith("deploy/") or name in ("Makefile", "compose.yaml")]
    names = [name for name in names if not name.endswith((".py", ".lock", ".md"))]
    assert {"Makefile", "deploy/Dockerfile", "compose.yaml", "deploy/telenano-relay.service"} <= set(names)
    unsafe = re.compile(r"(BIN\)/|[\"\s/])python3?\"?,?\s+\"?-[mc]\b")
    assert unsafe.search('CMD ["python", "-m", "x"]') and unsafe.search("\t$(BIN)/python -c x")
    found = {name: unsafe.findall((ROOT / name).read_text().replace("python3 -m http.server", "")) for name in names}
    assert not any(found.values()), found
    assert "PYTHONSAFEPATH=1" in (ROOT / "deploy/Dockerfile").read_text()
    for unit in (name for name in names if name.endswith(".service")):
        assert "PYTHONSAFEPATH=1" in (ROOT / unit).read_text()


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "foreign"
    folder.mkdir()
    for name in FOREIGN:
        text = "open(__file__ + '.ran', 'w').close()\nraise SystemExit('a file of the folder was run')\n"
        (folder / f"{name}.py").write_text(text)
    monkeypatch.chdir(folder)
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    return folder


def were_run(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.ran"))


@pytest.mark.usefixtures("foreign")
def test_a_python_that_is_started_imports_nothing_of_the_folder() -> None:
    for environment in (None, dict(os.environ)):
        done = children.run(
            [sys.executable, "-c", f"import services, telenano; {SHOWS_PATH}"],
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


IMPORTS = [sys.executable, "-c", "import services, numpy, telenano"]


def answer(words: list[str], environment: dict[str, str]) -> bool:
    return subprocess.run(words, env=environment, capture_output=True).returncode == 0


def by_entrypoint(folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    specification = importlib.util.spec_from_file_location("entrypoint", ROOT / "deploy" / "entrypoint.py")
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder))
    worked: list[bool] = []
    monkeypatch.setattr(os, "execvpe", lambda file, *given: worked.append(answer(*given)))
    module.main(IMPORTS)
    return worked == [True]


def by_node_command(folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    worked: list[bool] = []
    monkeypatch.setattr(os, "execvpe", lambda file, *given: worked.append(answer(*given)))
    context: Any = SimpleNamespace(args=["--help"])
    run_node(context, "recorder")
    return worked == [True]


def by_launcher(folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    nodes = NodeProcesses({"a@b": IMPORTS}, [], folder.parent / "logs", 0)
    nodes.start("a@b")
    ended: dict[str, int] = {}
    while not (ended := nodes.reap()):
        time.sleep(0.01)
    return ended == {"a@b": 0}


def by_fan_out(folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    endpoint = f"ipc://{folder.parent}/node"
    book = SimpleNamespace(
        nodes=["haptic_node@master"], uses_runtime_directory=True, local_endpoint=lambda name: endpoint
    )
    plan: Any = SimpleNamespace(attach=False, site=None, book=book)
    with fan_out(plan):
        end_s = time.monotonic() + 60.0
        while not (bound := is_bound(fan_out_endpoint(endpoint))) and not were_run(folder):
            assert time.monotonic() < end_s
            time.sleep(0.01)
    return bound


def by_child_session(folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    with pytest.raises(RigError) as caught:
        run_session([sys.executable, "-m", "telenano", "--help"])
    return "Show this message" in str(caught.value)


def by_servo(folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    with pytest.raises(DeviceError) as caught:
        ProcessLink("x", {}).open()
    return "there is no wire called 'x'" in str(caught.value)


def by_reader(folder: Path, monkeypatch: pytest.MonkeyPatch, watch: Callable[[float], None] | None = None) -> bool:
    others = folder.parent / "others"
    others.mkdir()
    (others / "a_reader.py").write_text("def read(path, *advance):\n    return path, []\n")
    monkeypatch.setattr(sys, "path", [str(others), *sys.path])
    with contextlib.suppress(ValueError):
        return read_in_child("a_reader:read", others / "a_reader.py", watch=watch)[0] == str(others / "a_reader.py")
    return False


def by_watched_reader(folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    return by_reader(folder, monkeypatch, lambda done: None)


def by_sweep(folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    # This program is started as a console script is: its own path is safe, and no flag of it says so to its workers.
    safe = "pass" if children.spawning_workers is SAFE else "children.spawning_workers = contextlib.nullcontext"
    code = (
        "import contextlib, os\n"
        "from telenano.signals import children\n"
        "if __name__ == '__main__':\n"
        f"    {safe}\n"
        "    print(sorted(children.in_processes(2, abs, [-7, -8])), 'PYTHONSAFEPATH' in os.environ)\n"
    )
    script = folder.parent / "bin" / "script.py"
    script.parent.mkdir()
    script.write_text(code)
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True)
    return done.stdout.strip() == "[(0, 7), (1, 8)] False" and not done.stderr


def by_experiment(folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    with pytest.raises(RigError) as caught:
        RigProcess(folder.parent / "rig", {}, ["--help"], lambda text: None)
    return "Show this message" in str(caught.value)


def by_measured_line(folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    line = measured_lines.Line("det6g", ("*.log",), (), "a line without a reading")
    logs = folder.parent / measured_lines.CAMPAIGNS["det6g"].folder
    logs.mkdir(parents=True)
    (logs / "empty.log").touch()
    with pytest.raises(SystemExit) as caught:
        measured_lines.fitted("a_line", line, folder.parent, folder.parent)
    return "empty.log" in str(caught.value) and "Traceback" not in str(caught.value)


def by_live_session(folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    with pytest.raises(RigError) as caught:
        live_sessions.summary_of(folder.parent / "rig", "passivity", "no_such_line")
    return "delay_node.profile" in str(caught.value)


def by_emulated_inverse3(folder: Path, monkeypatch: pytest.MonkeyPatch) -> bool:
    with pytest.raises(RigError) as caught, live_sessions.emulated_inverse3("no_such_scenario"):
        pass
    return "no_such_scenario" in str(caught.value)


SAFE = children.spawning_workers
Start = Callable[[Path, pytest.MonkeyPatch], bool]
# Every file that starts a process, and what starts one there, or why no path can matter.
STARTED: dict[str, tuple[Start, ...] | str] = {
    "deploy/entrypoint.py": (by_entrypoint,),
    "deploy/handover.py": "files of /opt, whose folder comes first on the path and is in a read-only image",
    "packages/telenano-lab/telenano_lab/afm_files/gwyddion.py": "Gwyddion's converter",
    "packages/telenano-laws/telenano_laws/live_sessions.py": (by_live_session, by_emulated_inverse3),
    "packages/telenano-lab/telenano_lab/networks/measured_lines.py": (by_measured_line,),
    "packages/telenano-lab/telenano_lab/experiments/apparatus/rig_process.py": (by_experiment,),
    "packages/telenano-lab/telenano_lab/studies/loops/sweep.py": (by_sweep,),
    "packages/telenano-devices/telenano_devices/handle/firmware/__init__.py": "a C compiler",
    "telenano/runtime/loop/own_process.py": (by_servo,),
    "telenano/cli/child_session.py": (by_child_session,),
    "telenano/launcher/fan_out.py": (by_fan_out,),
    "telenano/launcher/processes.py": (by_launcher,),
    "telenano/recording/provenance.py": "git",
    "telenano/virtual/simulate_all.py": "its workers are those of a sweep",
    "telenano/api.py": "its workers are those of a sweep",
    "packages/telenano-lab/telenano_lab/studies/comparison.py": "its workers are those of a sweep",
    "telenano/files/limited_child.py": (by_reader, by_watched_reader),
    "telenano/cli/commands/node.py": (by_node_command,),
    "telenano/doctor/checks.py": "Python with -I",
}


def test_each_start_is_in_the_table() -> None:
    found = {str(path.relative_to(ROOT)) for path in sources() if uses_children(path)}
    assert {name for name in found if not name.startswith("benchmarks/")} == set(STARTED)


@pytest.mark.check("takes 2.9 s")
@pytest.mark.drawn(0.3)
@pytest.mark.parametrize("safe", [True, False])
@pytest.mark.parametrize("start", [each for given in STARTED.values() if not isinstance(given, str) for each in given])
def test_what_a_start_runs_imports_nothing_of_the_folder(
    start: Start, safe: bool, foreign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not safe:
        monkeypatch.setattr(children, "_safe", list)
        monkeypatch.setattr(children, "_environment", lambda given: dict(os.environ if given is None else given))
        monkeypatch.setattr(children, "spawning_workers", contextlib.nullcontext)
    assert start(foreign, monkeypatch) is safe
    assert bool(were_run(foreign)) is not safe


def test_a_process_takes_the_place_of_this_one_with_a_safe_path() -> None:
    code = f"import sys; from telenano.signals import children; children.become([sys.executable, '-c', {SHOWS_PATH!r}])"
    assert children.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.split()[1:] == [
        "1",
        "True",
    ]


def test_a_signal_that_another_thread_has_received_ends_the_wait_for_futures() -> None:
    waits, stop = threading.Event(), threading.Event()

    def work() -> bool:
        waits.wait(60.0)
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)
        return stop.wait(60.0)

    signal.signal(signal.SIGINT, signal.default_int_handler)
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(work)
        with pytest.raises(KeyboardInterrupt):
            waits.set()
            list(children.as_ended([future]))
        stop.set()
    assert future.result(), "the wait ended before the work did"

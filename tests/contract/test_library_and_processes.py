"""`telenano` is the library and `services` are the processes: what one may name of the other, and what works alone."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from telenano.settings import DEMO_RECORDING

ROOT = Path(__file__).resolve().parents[2]
# The table of nodes; the table of commands finds its modules by it.
TABLES = {"telenano/wire/nodes.py"}

WITHOUT_LINUX = """
import os, select, signal, socket, sys
for name in ("fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"):
    sys.modules[name] = None
for module, names in (
    (os, "fork geteuid getuid sched_getaffinity sched_setaffinity O_CLOEXEC O_NOFOLLOW O_NONBLOCK"),
    (select, "epoll poll"),
    (signal, "SIGALRM SIGCHLD SIGHUP SIGKILL SIGUSR1 pthread_sigmask"),
    (socket, "AF_NETLINK AF_UNIX"),
):
    for name in names.split():
        if hasattr(module, name):
            delattr(module, name)
"""
# A notebook simulates, reads, reports and plots.
LIBRARY = """
import pathlib, sys, telenano
from telenano.cli.root import app

recording, out = sys.argv[1], pathlib.Path(sys.argv[2])
assert telenano.simulate("fig12").verdict == telenano.open(recording).summary["verdict"] == "stable"
for words in (
    ["bag", "info", recording],
    ["report", recording, "--out", str(out / "report")],
    ["bag", "plot", recording, "afm/state.tip_force_n.2", "--out", str(out / "plot.png")],
):
    try:
        app(words, standalone_mode=False)
    except SystemExit as end:
        assert not end.code, words
assert (out / "report" / "fig12.png").stat().st_size > 10_000 < (out / "plot.png").stat().st_size
print("imported:", sorted(name for name in sys.modules if name.partition(".")[0] == "services"))
"""


def texts_of_processes(path: Path) -> list[str]:
    """Return the texts of a module, parts of f-strings among them, that begin as the name of a process does."""
    values = [node.value for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Constant)]
    return [value for value in values if isinstance(value, str) and value.startswith("services.")]


def test_only_the_table_of_nodes_names_a_process() -> None:
    naming = {str(path.relative_to(ROOT)) for path in (ROOT / "telenano").rglob("*.py") if texts_of_processes(path)}
    assert naming == TABLES


@pytest.mark.parametrize(
    ("line", "names"), [('f"services.{name}"', True), ('"services.recorder.command"', True), ('"the services"', False)]
)
def test_a_name_of_a_process_is_found(line: str, names: bool, tmp_path: Path) -> None:
    (tmp_path / "module.py").write_text(f"A = {line}\n")
    assert bool(texts_of_processes(tmp_path / "module.py")) is names


@pytest.mark.check("simulates, reads and draws in a process of its own, three times")
@pytest.mark.parametrize("place", ["here", "where Linux's modules are not", "among files of the same names"])
def test_the_library_works_alone(place: str, tmp_path: Path) -> None:
    folder = tmp_path / "notes"
    folder.mkdir()
    if place == "among files of the same names":
        for name in ("analysis", "presets", "proto", "recording", "services", "studies"):
            (folder / name).mkdir()
            (folder / name / "__init__.py").write_text("raise SystemExit('a file of the folder was run')\n")
        (folder / "firmware.py").write_text("raise SystemExit('a file of the folder was run')\n")
    code = (WITHOUT_LINUX if "Linux" in place else "") + LIBRARY
    done = subprocess.run(
        # There is no -P, so that the folder comes first on the path, as it does for a notebook.
        [sys.executable, "-c", code, str(DEMO_RECORDING), str(tmp_path)],
        cwd=folder, capture_output=True, text=True, check=False, timeout=250,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("imported: []\n")

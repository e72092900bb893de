"""Recordings, studies and figures need nothing that only POSIX has; nodes need nothing that only Linux has."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from telenano.runtime.loop import realtime
from telenano.runtime.loop.log import StructuredLog
from telenano.runtime.loop.realtime import RealtimeStatus, apply_realtime
from telenano.settings.scenario import RealtimeConfig
from telenano.signals import children
from telenano.wire.errors import ConfigError

ROOT = Path(__file__).parents[3]

# Windows: no such modules, no numbers of users, no scheduling, none of the constants of opening files
PROGRAM = """
import importlib, os, sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name in ("fcntl", "termios", "tty", "pty", "resource", "pwd", "grp"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Hidden())
for name in ("fcntl", "termios", "tty", "pty", "resource", "pwd", "grp"):
    sys.modules.pop(name, None)
for name in ("getuid", "geteuid", "getgid", "sched_getaffinity", "sched_setscheduler", "sched_getscheduler", "nice",
             "O_NOFOLLOW", "O_CLOEXEC", "SCHED_FIFO", "getppid"):
    delattr(os, name)
from telenano.cli.lazy_commands import LAZY_COMMANDS, package_commands
for name in ("study", "bag", "report", "compare", "law", "scenario", "param", "curve", "scan", "sample",
             "reproduce", "new", "up", "topic", "record"):
    importlib.import_module((LAZY_COMMANDS.get(name) or package_commands()[name,]).module)
import json, pathlib, telenano
session = telenano.open(sys.argv[1])
tip = session.table("afm/state")
from telenano_lab.studies.comparison import compare, compare_figures, rows_of
from telenano.analysis.figure_style import FigureOptions
found = compare([pathlib.Path(sys.argv[1])] * 2)
files = FigureOptions(("svg",), "paper").drawn(compare_figures(found)[0], "compare")
print(json.dumps({"rows": len(tip["time_s"]), "verdict": session.summary["verdict"], "law": rows_of(found)[0]["law"],
                  "figure": len(files["compare.svg"])}))
"""


@pytest.mark.check("takes 3.5 s")
def test_recordings_and_figures_work_where_posix_is_not(recording_of: Callable[[str], Path]) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", PROGRAM, str(recording_of("wave"))]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["rows"] > 100
    assert found["law"] == "wave"
    assert found["figure"] > 10_000


def test_a_node_on_another_system_runs_without_real_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(realtime, "is_linux", lambda: False)
    # whatever is called of Linux fails
    monkeypatch.setattr(realtime.ctypes, "CDLL", None)
    monkeypatch.delattr(os, "sched_getaffinity")
    status = apply_realtime(RealtimeConfig(), StructuredLog("node"), "controller@master")
    assert status == RealtimeStatus(fifo=False, memory_locked=False)
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(sys, "platform", "darwin")
        children.die_with_parent(15)
    realtime.lower_thread("io")
    assert realtime.use_huge_pages() == 0
    for asked in (RealtimeConfig(scheduler="fifo"), RealtimeConfig(memory_lock="on")):
        with pytest.raises(ConfigError, match="no real-time scheduling"):
            apply_realtime(asked, StructuredLog("node"), "controller@master")


@pytest.mark.check("takes 0.6 s")
@pytest.mark.parametrize(
    ("hidden", "arguments", "text"),
    [
        ("numba", ["scan", "--out", "never"], "afm_node.model: dynamic needs numba: pip install "),
    ],
)
def test_a_bare_installation_says_what_to_add(hidden: str, arguments: list[str], text: str) -> None:
    code = f"import sys; sys.modules[{hidden!r}] = None; sys.argv = ['telenano', *{arguments!r}]; "
    code += "from telenano.cli.app import main; main()"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(f"telenano: {text}")
    assert done.stderr.count("\n") == 1

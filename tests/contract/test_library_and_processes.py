"""`telenano` is the library: it works alone, without a process of the rig."""

import subprocess
import sys
from pathlib import Path

import pytest

from telenano.settings import DEMO_RECORDING

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


@pytest.mark.check("simulates, reads and draws in a process of its own, three times")
@pytest.mark.parametrize(
    "place",
    [
        "here",
        pytest.param("where Linux's modules are not", marks=pytest.mark.endurance),
        pytest.param("among files of the same names", marks=pytest.mark.endurance),
    ],
)
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

"""A session of its own, for a command that runs several."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from telenano.cli.child_session import run_session
from telenano.cli.exit_codes import EXIT_INCOMPLETE
from telenano.wire.errors import RigError

# ends in its own time at SIGTERM, as `telenano up` does, and would not survive an unexpected SIGINT
_SESSION = """
import signal, sys, time
def end(number, frame):
    time.sleep(0.3)
    open("complete", "w").close()
    sys.exit(0)
signal.signal(signal.SIGTERM, end)
print('{{"runs": true}}', flush=True)
open("runs", "w").close()
time.sleep({seconds})
"""
_PARENT = """
import os, signal, sys, threading, time
from telenano.cli.child_session import run_session
from telenano.signals import interrupts

interrupts.install()


def end():
    while not os.path.exists("runs"):
        time.sleep(0.01)
    os.killpg(os.getpid(), signal.SIGINT) if {group} else os.kill(os.getpid(), signal.SIGTERM)


threading.Thread(target=end, daemon=True).start()
try:
    run_session([sys.executable, "-c", {session!r}])
except KeyboardInterrupt:
    print("interrupted", interrupts.exit_code())
"""


def test_a_session_gives_its_summary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    spent: list[float] = []
    summary = run_session([sys.executable, "-c", _SESSION.format(seconds=0.7)], 60.0, spent.append)
    assert summary == {"runs": True}
    assert spent


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        ("""print('{"error": "port taken"}'); sys.exit(1)""", "port taken"),
        ("""print('{"verdict": "stable"}'); sys.exit("Traceback")""", "Traceback"),
        ("""print('{"error": "no summary"}')""", "no summary"),
        ("print('no JSON')", "no JSON"),
        ("os.kill(os.getpid(), 9)", "no output"),
    ],
)
def test_a_session_that_fails_gives_its_own_reason(script: str, reason: str) -> None:
    with pytest.raises(RigError, match=f"^{reason}$"):
        run_session([sys.executable, "-c", f"import os, sys; {script}"])
    whole = f'import sys; print(\'{{"verdict": "stable"}}\'); sys.exit({EXIT_INCOMPLETE})'
    assert run_session([sys.executable, "-c", whole]) == {"verdict": "stable"}


@pytest.mark.check("waits for a session")
def test_one_that_takes_too_long_is_ended_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TimeoutError, match="did not end within 1 s"):
        run_session([sys.executable, "-c", _SESSION.format(seconds=60)], 1.0)
    assert (tmp_path / "complete").exists()


@pytest.mark.check("waits for a session")
@pytest.mark.parametrize(("group", "code"), [(False, 143), (True, 130)])
def test_a_session_of_its_own_ends_in_order_when_its_command_is_interrupted(
    group: bool, code: int, tmp_path: Path
) -> None:
    script = _PARENT.format(group=group, session=_SESSION.format(seconds=60))
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, cwd=tmp_path,
        start_new_session=True,
        # what a shell has in the background ignores SIGINT, and its children with it
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, f"interrupted {code}\n", "")
    # before the command went on
    assert (tmp_path / "complete").exists()

"""The README shows what its commands print: each line of output is one that the command prints, where … is any text."""

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from documents import LONGEST_S, PATIENCE_S, ROOT, environment_of, run
from stack_rig import SESSIONS, Rig

README = (ROOT / "README.md").read_text(encoding="utf-8")
# What can be read in a minute, commands and their output included.
WORDS = range(450, 551)
# What stands before the output of each command is replaced by what runs it here; None: it is not run by this test.
RUN_HERE = {
    "make demo": None,
    "make test": None,
    ". .venv/bin/activate": None,
    "telenano up touch": "--set viz_node.port=0",
    "telenano up fig12 --round-trip-ms 60 --out out/late": "--no-view",
    "python -c": "",
}


def shown() -> dict[str, list[str]]:
    """Return the lines of output below each command of the README."""
    found: dict[str, list[str]] = {}
    for block in re.findall(r"```console\n(.*?)```", README, re.DOTALL):
        for line in block.splitlines():
            if line.startswith("$ "):
                command = line[2:].partition("  #")[0].strip()
                found[command] = []
            else:
                found[command].append(line)
    return found


def pattern(line: str) -> str:
    return ".*".join(re.escape(part) for part in line.split("…"))


def assert_prints(printed: str, command: str) -> None:
    """Assert that the lines of output in the README come in this order in what a command printed."""
    lines = iter(printed.splitlines())
    for expected in shown()[command]:
        if expected != "…":
            assert any(re.fullmatch(pattern(expected), line) for line in lines), (expected, printed)


def test_the_readme_is_read_in_a_minute_and_every_command_of_it_is_known() -> None:
    assert len(README.split()) in WORDS
    assert len(shown()) == len(RUN_HERE)
    assert all(any(command.startswith(known) for known in RUN_HERE) for command in shown())


@pytest.mark.check("simulates a session")
def test_the_line_of_python_prints_its_verdict(tmp_path: Path) -> None:
    (command,) = [command for command in shown() if command.startswith("python -c")]
    code = re.fullmatch(r"python -c '(.*)'", command)
    assert code is not None
    done = run([sys.executable, "-c", code[1]], tmp_path)
    assert done.returncode == 0, done.stderr
    assert_prints(done.stdout, command)


def session(command: str, folder: Path, environment: dict[str, str]) -> tuple[str, str]:
    """Return the output and the warnings of a session; one of a person ends as that person ends it, by Ctrl-C."""
    words = [sys.executable, "-m", "telenano", *command.split()[1:], *(RUN_HERE[command] or "").split(), "--overwrite"]
    pipe = subprocess.PIPE
    with subprocess.Popen(words, cwd=folder, env=environment, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        printed = ""
        while "touch" in command and "running for" not in printed and (line := process.stdout.readline()):
            printed += line
        if "touch" in command:
            process.send_signal(signal.SIGINT)
        rest, err = process.communicate(timeout=2 * PATIENCE_S)
    assert process.returncode in (0, 3), err
    return re.sub(r"(view: http://127\.0\.0\.1:)\d+", r"\g<1>8650", printed + rest), err


@pytest.mark.stack
@pytest.mark.endurance
@pytest.mark.timeout(LONGEST_S)
@pytest.mark.parametrize("command", [command for command in shown() if command.startswith(("make demo", "telenano"))])
def test_a_session_prints_what_the_readme_shows(command: str, rig: Rig, tmp_path: Path) -> None:
    environment = {**environment_of(), "TELENANO_RUNTIME_DIR": str(rig.sockets)}
    # a machine that holds the loop up gives another session, and says so
    for _ in range(SESSIONS):
        if command == "make demo":
            done = run(["make", "demo"], ROOT, environment)
            assert done.returncode == 0, done.stderr
            # the environment is made once
            printed, err = f"{shown()[command][0]}\n{done.stdout}", done.stderr
        else:
            printed, err = session(command, tmp_path, environment)
        if "not only the law" not in err:
            break
    assert_prints(printed, command)

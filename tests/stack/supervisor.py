"""A stand-in for systemd: starts what a unit names, and starts it again as the unit says, until SIGTERM.

    python supervisor.py UNIT LOG [ARGUMENT ...]

The command is that of `ExecStart`, with this Python's telenano in place of the installed one, and ARGUMENTs after it.
Each start and each end is a line of LOG. What a unit says of users, limits and folders is left to the test.
"""

import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path
from string import Template

_LOOK_S = 0.05


def settings_of(unit: Path) -> dict[str, str]:
    """Return the settings of the section Service by name; one that is given several times has its last value."""
    text = unit.read_text(encoding="utf-8").partition("[Service]")[2].partition("[Install]")[0]
    lines = (line.partition("=") for line in text.splitlines() if "=" in line and not line.startswith("#"))
    return {name: value for name, _, value in lines}


def main(unit: str, log: str, *further: str) -> None:
    """Keep the service of a unit running until SIGTERM."""
    settings = settings_of(Path(unit))
    variables = dict(part.partition("=")[::2] for part in shlex.split(settings["Environment"]))
    words = shlex.split(Template(settings["ExecStart"]).safe_substitute({**variables, **os.environ}))
    command = [sys.executable, "-P", "-m", "telenano", *words[1:], *further]
    is_ended = False

    def end(number: int, frame: object) -> None:
        nonlocal is_ended
        is_ended = True

    signal.signal(signal.SIGTERM, end)
    with Path(log).open("a", encoding="utf-8", buffering=1) as lines:
        while not is_ended:
            process = subprocess.Popen(command, stdout=lines, stderr=lines)
            lines.write(f"started {process.pid}\n")
            while process.poll() is None and not is_ended:
                time.sleep(_LOOK_S)
            if is_ended:
                process.send_signal(signal.Signals[settings["KillSignal"]])
            code = process.wait()
            lines.write(f"ended {process.pid} with {code}\n")
            if settings["Restart"] == "on-failure" and code == 0:
                return
            due_s = time.monotonic() + float(settings["RestartSec"])
            while time.monotonic() < due_s and not is_ended:
                time.sleep(_LOOK_S)


if __name__ == "__main__":
    main(*sys.argv[1:])

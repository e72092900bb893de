"""Commands that are interrupted by a signal, as separate processes, and the files that they leave."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

_CAUGHT = re.compile(r"^SigCgt:\s*([0-9a-f]+)$", re.MULTILINE)
_PATIENCE_S = 240.0


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    stdout: str
    stderr: str


def environment() -> dict[str, str]:
    """Return an environment with a terminal of 200 columns and without colours."""
    return {**os.environ, "COLUMNS": "200", "NO_COLOR": "1"}


def interrupted(
    arguments: Sequence[str], folder: Path, number: signal.Signals, delay_s: float, *, group: bool = False
) -> Ended:
    """Run a command in a folder and send it a signal, `delay_s` [s] after it began to catch signals.

    Parameters: group, whether to send it to the children too, as a terminal does.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", "telenano", *arguments], cwd=folder, env=environment(), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
        preexec_fn=as_at_a_terminal,
    )  # fmt: skip
    # Before the command catches signals, one would end it without a message, as any process.
    while process.poll() is None and not _catches(process.pid, signal.SIGTERM):
        time.sleep(0.01)
    try:
        out, err = process.communicate(timeout=delay_s)
    except subprocess.TimeoutExpired:
        (os.killpg if group else os.kill)(process.pid, number)
        out, err = process.communicate(timeout=_PATIENCE_S)
    return Ended(process.returncode, out, err)


def as_at_a_terminal() -> None:
    """Restore the reaction to SIGINT: background processes of a shell ignore it, and so do their children."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _catches(process: int, number: signal.Signals) -> bool:
    found = _CAUGHT.search(Path(f"/proc/{process}/status").read_text())
    return found is not None and bool(int(found.group(1), 16) >> (number - 1) & 1)


def files_below(folder: Path) -> list[str]:
    """Return the files in a folder and below it, without the journals from which a study continues."""
    found = (path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    return sorted(name for name in found if not name.endswith("journal.jsonl"))

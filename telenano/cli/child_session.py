"""Run a session in a `telenano up` process of its own, for commands that run several; it ends in order when they do."""

import json
import subprocess
import time
from collections.abc import Callable, Sequence
from typing import Any

from telenano.cli.exit_codes import EXIT_INCOMPLETE
from telenano.signals import children
from telenano.wire.errors import RigError

_LOOK_S = 0.5


def run_session(
    command: Sequence[str], most_s: float | None = None, progress: Callable[[float], object] = lambda spent_s: None
) -> dict[str, Any]:
    """Run a `telenano up … --json` to its end and return its summary, even if its recording is incomplete.

    Ctrl-C and SIGTERM at this process end the session as Ctrl-C at its own terminal does: the devices are made safe and
    the recording is completed before the interruption continues.

    Args:
        command: The command and its arguments.
        most_s: The longest time that the session may take [s]; None for no limit.
        progress: Called twice a second with the time so far [s].

    Raises:
        TimeoutError: The session took longer and was ended.
        RigError: The session failed; the text is its own report.
    """
    begun_s = time.monotonic()
    pipe = subprocess.PIPE
    with children.start(command, ends_with_command=True, stdout=pipe, stderr=pipe, text=True) as session:
        try:
            while True:
                try:
                    out, err = session.communicate(timeout=_LOOK_S)
                    return _summary(session.returncode, out, err)
                except subprocess.TimeoutExpired:
                    spent_s = time.monotonic() - begun_s
                    progress(spent_s)
                    if most_s is not None and spent_s > most_s:
                        raise TimeoutError(f"the session did not end within {most_s:.0f} s") from None
        except BaseException:
            session.terminate()
            session.communicate()
            raise


def _summary(code: int, out: str, err: str) -> dict[str, Any]:
    """Return the summary that a session has printed; RigError with the session's own reason if it failed."""
    try:
        document: dict[str, Any] = json.loads(out)
    except ValueError:
        document = {}
    if code not in (0, EXIT_INCOMPLETE) or not document or "error" in document:
        raise RigError(str(document.get("error") or err.strip() or out.strip() or "no output"))
    return document

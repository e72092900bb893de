"""A session by a `telenano up` of its own, for commands that run several; it ends in order when they do."""

import subprocess
import time
from collections.abc import Callable, Sequence

from telenano.signals import children
from telenano.signals.interrupts import kept_from_children

_LOOK_S = 0.5


def run_session(
    command: Sequence[str], most_s: float | None = None, progress: Callable[[float], object] = lambda spent_s: None
) -> "subprocess.CompletedProcess[str]":
    """Run a command to its end.

    Ctrl-C and SIGTERM at this process end the session as Ctrl-C at its own terminal does: the devices are made safe and
    the recording is complete before the interruption continues.

    Args:
        command: The command and its arguments.
        most_s: How long the session may take [s].
        progress: Called twice a second with the time so far [s].

    Raises:
        TimeoutError: The session took longer; it has ended.
    """
    begun_s = time.monotonic()
    pipe = subprocess.PIPE
    with kept_from_children():
        session = children.start(command, stdout=pipe, stderr=pipe, text=True)
    with session:
        try:
            while True:
                try:
                    out, err = session.communicate(timeout=_LOOK_S)
                    return subprocess.CompletedProcess(list(command), session.returncode, out, err)
                except subprocess.TimeoutExpired:
                    spent_s = time.monotonic() - begun_s
                    progress(spent_s)
                    if most_s is not None and spent_s > most_s:
                        raise TimeoutError(f"the session did not end within {most_s:.0f} s") from None
        except BaseException:
            session.terminate()
            session.communicate()
            raise

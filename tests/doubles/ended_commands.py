"""A command of telenano in a forked process, with its whole command line, and how it ends.

    end = ended(["scenario", "check", "fig12"], most_s=2.0)
    assert not isinstance(end, str) and end.code == 0

A forked child has the modules of this process already, so another command takes only a tenth of a second.
"""

import contextlib
import faulthandler
import math
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NoReturn

from telenano.cli.app import main


@dataclass(frozen=True)
class Ended:
    """The end of a command: exit code, output, and the traceback of an unhandled exception, empty if there is none."""

    code: int
    output: str
    raised: str


def ended(words: Sequence[str], most_s: float) -> Ended | str:
    """Run a command in a child; return how it ended, or its output and stack if it takes longer than `most_s` [s].

    That is processor time; the limit on the clock is four times as long, for a command that only waits. A forked child
    has all modules already, and can be killed in the middle of compiled code.
    """
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as stands:
        child = os.fork()
        if child == 0:
            os.setsid()
            _limit(most_s, stands.fileno())
            _run(words, output.fileno())
        _, status = os.waitpid(child, 0)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        output.seek(0)
        stands.seek(0)
        text = output.read().decode(errors="replace")
        if os.WIFSIGNALED(status) or stands.read(1):
            stands.seek(0)
            return f"{text}\n{stands.read().decode()}"
    before, _, raised = text.partition("Traceback (most recent call last)")
    return Ended(os.waitstatus_to_exitcode(status), before, raised)


def _limit(most_s: float, stands: int) -> None:
    """End this process if it takes longer than a time [s]; its stack is then written to a file descriptor."""
    faulthandler.enable(stands)
    faulthandler.register(signal.SIGXCPU, stands, all_threads=False, chain=True)
    faulthandler.dump_traceback_later(4.0 * most_s, file=stands, exit=True)
    used_s = math.ceil(time.process_time() + most_s)
    resource.setrlimit(resource.RLIMIT_CPU, (used_s, used_s + 1))


def _run(words: Sequence[str], output: int) -> NoReturn:
    """Run a command as this process, with its whole command line, and end with its exit code."""
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(output, 1)
    os.dup2(output, 2)
    sys.stdin, sys.stdout, sys.stderr = (
        os.fdopen(number, mode, encoding="utf-8", errors=errors)
        for number, mode, errors in ((0, "r", None), (1, "w", "strict"), (2, "w", "backslashreplace"))
    )
    sys.argv = ["telenano", *words]
    code = 0
    try:
        main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(end.code is not None)
    # The test is about exceptions that a command does not handle.
    except BaseException:  # noqa: BLE001
        code = 1
        traceback.print_exc()
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(code)

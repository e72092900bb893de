"""The entry point of the `telenano` command."""

import contextlib
import gc
import os
import sys
from collections.abc import Sequence

# A priority below that of the nodes, whose loops continue while the stop is in transit.
_URGENT = 1


def main() -> None:
    """Run the command line; an emergency stop runs without the imports that the other commands need."""
    from telenano.cli import terminal

    terminal.install()
    arguments = sys.argv[1:]
    if "estop" in arguments[:2]:
        _hurry()
        from telenano.cli.estop_command import read_arguments, run_estop

        request = read_arguments(arguments)
        if request is not None:
            raise SystemExit(run_estop(request))
    # The import is this late because a stop needs none of it.
    from telenano.signals import interrupts

    interrupts.install()
    # Garbage collection is off during imports: their objects stay, and searching them took a sixth of the time.
    gc.disable()
    try:
        from telenano.cli.root import app

        app()
    except SystemExit as end:
        # A command whose reader, such as `head`, has closed the pipe is ended by the libraries; the reader had enough:
        # code 0.
        raise (SystemExit(0) if isinstance(end.__context__, BrokenPipeError) else end) from None
    except BaseException:
        # After a signal the command was interrupted, whatever exception a library makes of it.
        if not interrupts.received():
            raise
        raise SystemExit(_interrupted(arguments, interrupts.exit_code())) from None
    finally:
        interrupts.restore()


def _interrupted(arguments: Sequence[str], code: int) -> int:
    """Print that a signal ended a command that reports no interruption itself; return the exit code."""
    import json

    with contextlib.suppress(OSError):
        sys.stderr.write("telenano: interrupted\n")
        if "--json" in arguments:
            sys.stdout.write(json.dumps({"error": "interrupted"}) + "\n")
        sys.stdout.flush()
    return code


def _hurry() -> None:
    """Take a real-time priority where permitted: a busy machine may leave other processes a tenth of its time."""
    # No object here lives long enough to be collected.
    gc.disable()
    # Only Linux has these priorities.
    with contextlib.suppress(PermissionError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_URGENT))

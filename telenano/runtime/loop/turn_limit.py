"""Time limit of a turn in a process of several nodes: the process is ended before a blocked device becomes dangerous.

A node that hangs in a separate process does not block the node of the device, which holds and withdraws by itself. In a
shared process (`telenano/runtime/site`) it does, so a turn has a limit there, by two timers of the kernel:

- processor time: its signal keeps the default action, so that compiled code that never returns is ended too;
- time in which the process could run, for a turn that waits: it is counted in ticks, which the kernel sends one by one
  as they are handled, so that a process is not ended because it was stopped or did not get the processor.

The second timer does not detect a turn that waits in a call that no signal interrupts.
"""

import math
import os
import signal
import time
from collections.abc import Callable
from io import FileIO
from pathlib import Path
from types import FrameType

# Longest turn [s]. The kernel counts processor time in ticks of 10 ms at most, so a process is ended within 60 ms.
LIMIT_S = 0.05
# Interval at which the time in which the process could run is measured [s].
TICK_S = 0.01
# The signal that ends a process because of a turn; Windows has no such signal.
SIGNAL = getattr(signal, "SIGVTALRM", None)
_SCHEDSTAT = Path("/proc/self/schedstat")


class TurnLimit:
    """The limit of the turns of a process: `begin` before each, and `end` after it.

    Args:
        whose: Returns the node of the current turn, for the log of a process that is ended.
        tell: Writes a line to the log.
    """

    def __init__(self, whose: Callable[[], str], tell: Callable[[str], None]) -> None:
        self._whose, self._tell = whose, tell
        self._could_run_s = self._at_s = self._waited_s = 0.0
        # The file stays open: in a turn there may be no descriptor left, and a wait for a processor must not pass for a
        # turn that does not end.
        self._schedstat = _opened(_SCHEDSTAT)
        if SIGNAL is not None:
            signal.signal(SIGNAL, signal.SIG_DFL)
            signal.signal(signal.SIGALRM, self._tick)

    def begin(self) -> None:
        """Begin a turn, and start both timers."""
        if SIGNAL is not None:
            self._could_run_s = 0.0
            signal.setitimer(signal.ITIMER_VIRTUAL, LIMIT_S)
            signal.setitimer(signal.ITIMER_REAL, TICK_S, TICK_S)

    def end(self) -> None:
        """End the turn, and stop both timers: the time until the next turn is not limited."""
        if SIGNAL is not None:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _tick(self, number: int, frame: FrameType | None) -> None:
        now_s, waited_s = time.monotonic(), waited_for_processor_s(self._schedstat)
        if waited_s is None:
            # Whether the process could run is not known; the processor time of the turn is limited all the same.
            return
        if self._could_run_s == 0.0:
            self._could_run_s = TICK_S
        else:
            # A time in which the process was stopped counts as one tick, however long it was.
            ran_s = now_s - self._at_s - (waited_s - self._waited_s)
            self._could_run_s += min(max(ran_s, 0.0), TICK_S)
        self._at_s, self._waited_s = now_s, waited_s
        if self._could_run_s >= LIMIT_S - 0.5 * TICK_S and SIGNAL is not None:
            # A tick that comes while the line is written must not write it again.
            self._could_run_s = -math.inf
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            self._tell(f"a turn of {self._whose()} has not ended within {1e3 * LIMIT_S:.0f} ms: its process is ended")
            os.kill(os.getpid(), SIGNAL)


def _opened(path: Path) -> FileIO | None:
    try:
        return FileIO(path)
    except OSError:
        return None


def waited_for_processor_s(schedstat: FileIO | None) -> float | None:
    """Return the time for which the main thread of this process has waited for a processor [s]; None if not known.

    Args:
        schedstat: The open file of the kernel with that time; None on a kernel that does not count it, for 0.0.
    """
    if schedstat is None:
        return 0.0
    try:
        return int(os.pread(schedstat.fileno(), 128, 0).split()[1]) * 1e-9
    except (OSError, IndexError, ValueError):
        return None

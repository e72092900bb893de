"""A process of several nodes whose turn does not end is ended, before what it holds up becomes dangerous.

A node of its own that hangs leaves the node of the device alone, which holds and withdraws by itself. In a process that
they share (`telenano/runtime/site`) it cannot, so a turn has a limit there, by two timers of the kernel:

- processor time: the action of its signal is the system's own, so that compiled code which never returns is ended too;
- time in which the process could run, for a turn that waits for something: it is counted in ticks, which the kernel
  sends one by one as they are taken, so that a process that was stopped, or was not let run, is not ended for that.

A turn that waits in a call which no signal interrupts is not seen by the second one.
"""

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType

# A turn may take so long. The kernel counts processor time in ticks of its own, of 10 ms at most, so a process is ended
# within 60 ms.
LIMIT_S = 0.05
# The time in which the process could run is looked at at this interval.
TICK_S = 0.01
# A process that is ended for a turn is ended by this signal; Windows has no such signal.
SIGNAL = getattr(signal, "SIGVTALRM", None)
_SCHEDSTAT = Path("/proc/self/schedstat")


class TurnLimit:
    """The limit of the turns of a process: `begin` before each, and `end` after it.

    Args:
        whose: Returns what the turn in hand is of, for the log of a process that is ended.
        tell: Writes a line to the log.
    """

    def __init__(self, whose: Callable[[], str], tell: Callable[[str], None]) -> None:
        self._whose, self._tell = whose, tell
        self._could_run_s = self._at_s = self._waited_s = 0.0
        if SIGNAL is not None:
            signal.signal(SIGNAL, signal.SIG_DFL)
            signal.signal(signal.SIGALRM, self._tick)

    def begin(self) -> None:
        """Begin a turn."""
        if SIGNAL is not None:
            self._could_run_s = 0.0
            signal.setitimer(signal.ITIMER_VIRTUAL, LIMIT_S)
            signal.setitimer(signal.ITIMER_REAL, TICK_S, TICK_S)

    def end(self) -> None:
        """End the turn: what comes until the next one takes any time."""
        if SIGNAL is not None:
            signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _tick(self, number: int, frame: FrameType | None) -> None:
        now_s, waited_s = time.monotonic(), waited_for_processor_s()
        if self._could_run_s == 0.0:
            self._could_run_s = TICK_S
        else:
            # Of a time in which the process was stopped there is one tick, however long it was.
            ran_s = now_s - self._at_s - (waited_s - self._waited_s)
            self._could_run_s += min(max(ran_s, 0.0), TICK_S)
        self._at_s, self._waited_s = now_s, waited_s
        if self._could_run_s >= LIMIT_S - 0.5 * TICK_S and SIGNAL is not None:
            self._tell(f"a turn of {self._whose()} has not ended within {1e3 * LIMIT_S:.0f} ms: its process is ended")
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            os.kill(os.getpid(), SIGNAL)


def waited_for_processor_s() -> float:
    """Return how long the main thread of this process was ready to run and not let run [s]; 0 where nobody counts."""
    try:
        return int(_SCHEDSTAT.read_bytes().split()[1]) * 1e-9
    except (OSError, IndexError, ValueError):
        return 0.0

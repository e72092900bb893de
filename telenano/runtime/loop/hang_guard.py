"""Limit of processor time by which the kernel ends a node that computes without end, so that it is restarted.

Under SCHED_FIFO, a step that never returns blocks all threads of the same priority on its processor: the node of the
device could neither release the hand nor retract the tip. A signal handler of this process could not help, because the
process may be in compiled code. So the signal keeps its default action, which ends the process, and the launcher starts
it again.

The watchdog of the launcher (`telenano/launcher/watchdog.py`) cannot replace the limit: a node that hangs under
SCHED_FIFO may block the launcher as well, and a node in a container has no launcher.
"""

import contextlib
import signal

# Most processor time of all threads since the last report of health, which is sent twice a second [s]. A node that is
# stopped, or blocked by others, uses none.
LIMIT_S = 1.5


class HangGuard(contextlib.AbstractContextManager["HangGuard"]):
    """A limit of processor time that restarts at each `renew`; without effect on systems other than Unix."""

    def __enter__(self) -> "HangGuard":
        if hasattr(signal, "SIGPROF"):
            signal.signal(signal.SIGPROF, signal.SIG_DFL)
        self.renew()
        return self

    def __exit__(self, *error: object) -> None:
        self._set(0.0)

    def renew(self) -> None:
        """Restart the time."""
        self._set(LIMIT_S)

    def _set(self, limit_s: float) -> None:
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_PROF, limit_s)

"""A node that computes without end is ended by the kernel, so that those on its processor continue and it is restarted.

Under SCHED_FIFO nothing of the same priority runs beside a step that never returns: the node of the device could not
let the hand go, nor retract the tip. No handler of this process could help, which may be within compiled code: the
action of the signal is the system's own, which ends the process, and the launcher starts it again.

The watchdog of the launcher (`telenano/launcher/watchdog.py`) cannot replace it: a node that hangs under SCHED_FIFO may
keep the processor from the launcher as well, and a node in a container has no launcher at all.
"""

import contextlib
import signal

# The processor time of all threads since the last report of health, which is sent twice a second. A node that is
# stopped, or starved by others, uses none.
LIMIT_S = 1.5


class HangGuard(contextlib.AbstractContextManager["HangGuard"]):
    """A limit of processor time that is set again at each `renew`; other systems than Unix have none."""

    def __enter__(self) -> "HangGuard":
        if hasattr(signal, "SIGPROF"):
            signal.signal(signal.SIGPROF, signal.SIG_DFL)
        self.renew()
        return self

    def __exit__(self, *error: object) -> None:
        self._set(0.0)

    def renew(self) -> None:
        """Begin the time again."""
        self._set(LIMIT_S)

    def _set(self, limit_s: float) -> None:
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_PROF, limit_s)

"""Restart policy: when a node whose process ended is restarted, and when the rig is given up.

It only decides, on an injected clock; the supervisor acts on processes.
"""

import signal
from collections import deque
from collections.abc import Collection, Iterable
from dataclasses import dataclass

from telenano.runtime.loop import hang_guard, turn_limit
from telenano.runtime.wiring.main import EXIT_BAD_START
from telenano.timing.clock import Clock

_EXITS_KEPT = 8
# First delay before a restart, which then doubles [s].
FIRST_DELAY_S = 0.1
# Greatest delay before a restart [s].
MAX_DELAY_S = 5.0
# A node that ran for at least this time before it ended is restarted after the first delay again [s].
HEALTHY_LIFE_S = 10.0
# Number of ends within CRASH_LOOP_WINDOW_S at which a node is given up, and the rig with it.
CRASH_LOOP_EXITS = 5
CRASH_LOOP_WINDOW_S = 30.0


@dataclass(frozen=True)
class ProcessExit:
    """The end of a node's process with the decision: `restart_in_s` is the delay [s], None if the node is given up.

    `exit_code` is that of subprocess, negative for a signal; `life_s`: run time of the process [s]; `verdict`: the
    decision in words.
    """

    node: str
    exit_code: int
    life_s: float
    restart_in_s: float | None
    verdict: str

    @property
    def given_up(self) -> bool:
        """Whether the node is not restarted, which ends the rig."""
        return self.restart_in_s is None


class _History:
    def __init__(self) -> None:
        self.started_ns = 0
        self.delay_s = 0.0
        self.restart_ns: int | None = None
        self.exits_ns: deque[int] = deque()
        self.exits: deque[ProcessExit] = deque(maxlen=_EXITS_KEPT)
        self.restarts = 0


class RestartTracker:
    """Records starts and exits of every node, and decides when each is restarted."""

    def __init__(self, clock: Clock, nodes: Iterable[str], *, beside: Collection[str] = ()) -> None:
        """Track `nodes`, and those `beside` the rig, which are restarted however often they end."""
        self._clock, self._beside = clock, beside
        self._histories = {node: _History() for node in (*nodes, *beside)}

    def record_start(self, node: str) -> None:
        """Record a start, which is a restart when one was due."""
        history = self._histories[node]
        history.started_ns = self._clock.monotonic_ns()
        if history.restart_ns is not None:
            history.restarts += 1
        history.restart_ns = None

    def record_exit(self, node: str, exit_code: int) -> ProcessExit:
        """Record an exit (code as of subprocess: negative is a signal), decide on the restart, and return both."""
        process_exit = self._decide(node, self._histories[node], exit_code)
        self._histories[node].exits.append(process_exit)
        return process_exit

    def _decide(self, node: str, history: _History, exit_code: int) -> ProcessExit:
        now = self._clock.monotonic_ns()
        life_s = (now - history.started_ns) * 1e-9
        history.exits_ns.append(now)
        while now - history.exits_ns[0] > CRASH_LOOP_WINDOW_S * 1e9:
            history.exits_ns.popleft()
        if exit_code == EXIT_BAD_START:
            return ProcessExit(node, exit_code, life_s, None, "it cannot start as it is configured and is not retried")
        if len(history.exits_ns) >= CRASH_LOOP_EXITS and node not in self._beside:
            verdict = f"it died {len(history.exits_ns)} times within {CRASH_LOOP_WINDOW_S:g} s"
            return ProcessExit(node, exit_code, life_s, None, verdict)
        reset = life_s >= HEALTHY_LIFE_S or history.delay_s == 0.0
        doubled = min(2.0 * history.delay_s, MAX_DELAY_S)
        history.delay_s = FIRST_DELAY_S if reset else doubled
        history.restart_ns = now + round(history.delay_s * 1e9)
        return ProcessExit(node, exit_code, life_s, history.delay_s, f"it is started again in {history.delay_s:g} s")

    def due(self) -> list[str]:
        now = self._clock.monotonic_ns()
        return [node for node, history in self._histories.items() if history.restart_ns and history.restart_ns <= now]

    def exits(self, node: str) -> list[ProcessExit]:
        return list(self._histories[node].exits)

    def restarts(self, node: str) -> int:
        return self._histories[node].restarts


def describe_exit(exit_code: int) -> str:
    """Describe how a process ended; a negative code is the signal that killed it, as of subprocess."""
    if exit_code >= 0:
        return f"ended with exit code {exit_code}"
    if hasattr(signal, "SIGPROF") and exit_code == -signal.SIGPROF:
        return f"hung: it computed for {hang_guard.LIMIT_S:g} s without a report, and the kernel ended it"
    if turn_limit.SIGNAL is not None and exit_code == -turn_limit.SIGNAL:
        limit_ms = 1e3 * turn_limit.LIMIT_S
        return f"hung: a turn took more than {limit_ms:.0f} ms, which ends a process of several nodes"
    try:
        return f"was killed by {signal.Signals(-exit_code).name}"
    except ValueError:
        return f"was killed by signal {-exit_code}"

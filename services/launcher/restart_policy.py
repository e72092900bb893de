"""When a node that died is started again, and when the rig is given up: decisions only, no process is touched here."""

import signal
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from services.runtime.clock import Clock
from services.runtime.main import EXIT_BAD_START

_REMEMBERED_DEATHS = 8


@dataclass(frozen=True)
class RestartPolicy:
    """How patient the supervisor is."""

    first_delay_s: float = 0.1
    longest_delay_s: float = 5.0
    healthy_life_s: float = 10.0
    crash_loop_deaths: int = 5
    crash_loop_window_s: float = 30.0


@dataclass(frozen=True)
class ProcessExit:
    """What the supervisor makes of the end of a node."""

    node: str
    exit_code: int
    life_s: float
    restart_in_s: float | None
    verdict: str

    @property
    def given_up(self) -> bool:
        """Say whether the node is not started again, which ends the rig."""
        return self.restart_in_s is None


class _Account:
    def __init__(self) -> None:
        self.started_ns = 0
        self.delay_s = 0.0
        self.restart_ns: int | None = None
        self.deaths_ns: deque[int] = deque()
        self.deaths: deque[ProcessExit] = deque(maxlen=_REMEMBERED_DEATHS)
        self.restarts = 0


class RestartTracker:
    """The account of every node: its starts, its deaths, and when it is due again."""

    def __init__(self, clock: Clock, nodes: Iterable[str], policy: RestartPolicy | None = None) -> None:
        self._clock = clock
        self._policy = policy or RestartPolicy()
        self._accounts = {node: _Account() for node in nodes}

    def started(self, node: str) -> None:
        """Enter a start."""
        account = self._accounts[node]
        account.started_ns = self._clock.monotonic_ns()
        if account.restart_ns is not None:
            account.restarts += 1
        account.restart_ns = None

    def died(self, node: str, exit_code: int) -> ProcessExit:
        """Enter a death (exit code as of subprocess: negative is a signal) and decide what follows."""
        death = self._judge(node, self._accounts[node], exit_code)
        self._accounts[node].deaths.append(death)
        return death

    def _judge(self, node: str, account: _Account, exit_code: int) -> ProcessExit:
        policy, now = self._policy, self._clock.monotonic_ns()
        life_s = (now - account.started_ns) * 1e-9
        account.deaths_ns.append(now)
        while now - account.deaths_ns[0] > policy.crash_loop_window_s * 1e9:
            account.deaths_ns.popleft()
        if exit_code == EXIT_BAD_START:
            return ProcessExit(node, exit_code, life_s, None, "it cannot start as it is configured and is not retried")
        if len(account.deaths_ns) >= policy.crash_loop_deaths:
            verdict = f"it died {len(account.deaths_ns)} times within {policy.crash_loop_window_s:g} s"
            return ProcessExit(node, exit_code, life_s, None, verdict)
        lived_well = life_s >= policy.healthy_life_s or account.delay_s == 0.0
        doubled = min(2.0 * account.delay_s, policy.longest_delay_s)
        account.delay_s = policy.first_delay_s if lived_well else doubled
        account.restart_ns = now + round(account.delay_s * 1e9)
        return ProcessExit(node, exit_code, life_s, account.delay_s, f"it is started again in {account.delay_s:g} s")

    def due(self) -> list[str]:
        """Give the nodes whose time to be started again has come."""
        now = self._clock.monotonic_ns()
        return [node for node, account in self._accounts.items() if account.restart_ns and account.restart_ns <= now]

    def deaths(self, node: str) -> list[ProcessExit]:
        """Give the last deaths of a node, in order."""
        return list(self._accounts[node].deaths)

    def restarts(self, node: str) -> int:
        """Give how often a node was started again."""
        return self._accounts[node].restarts


def ending(exit_code: int) -> str:
    """Say in words how a process ended; a negative code is the signal that killed it, as of subprocess."""
    if exit_code >= 0:
        return f"ended with exit code {exit_code}"
    try:
        return f"was killed by {signal.Signals(-exit_code).name}"
    except ValueError:
        return f"was killed by signal {-exit_code}"

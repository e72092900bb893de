"""A recorder that is behind when it is to begin a new file: how far, and how long it is waited for."""

from collections.abc import Callable

from proto.messages import NodeHealth
from services.launcher.liveness import NODE_TIMEOUT_S
from services.launcher.readiness import input_ages_s
from services.runtime.clock import Clock

# more than a flush and a report of its health; a recorder that keeps up is behind by milliseconds
BEHIND_S = 1.0
_LIMIT_S = 20.0
_REPORT_NS = 1_000_000_000


class RecorderWait:
    """Determines whether the recorder of a rig that goes on has what was sent in a session, within a limit.

    The command to begin a new file reaches it before what still waits of the session, which would then be in the file
    after the session's.
    """

    def __init__(
        self, clock: Clock, recorder: str, publishes: Callable[[str], bool], report: Callable[[str], None]
    ) -> None:
        """Prepare to wait.

        Parameters: publishes, whether a node is at work now: what another one sent last grows old without a fault of
        the recorder; report, called with the lines of progress.
        """
        self.recorder = recorder
        self._publishes = publishes
        self._clock = clock
        self._report = report
        self._received_ns: int | None = None
        self._lag_s = 0.0
        self._until_ns: int | None = None
        self._report_ns = 0

    def record(self, health: NodeHealth) -> None:
        """Take note of how old the newest inputs of the recorder are."""
        if health.src == self.recorder:
            self._received_ns = self._clock.monotonic_ns()
            ages = (age_s for (_, src), age_s in input_ages_s(health).items() if self._publishes(src))
            self._lag_s = max(ages, default=0.0)

    def behind_s(self) -> float:
        """Return how far the recorder is behind [s]; 0 for one that was never received or keeps up."""
        if self._received_ns is None:
            return 0.0
        silence_s = (self._clock.monotonic_ns() - self._received_ns) * 1e-9
        if silence_s >= NODE_TIMEOUT_S:
            # it writes nothing either
            return silence_s
        return self._lag_s if self._lag_s >= BEHIND_S else 0.0

    def over(self) -> bool:
        """Return whether there is no more to wait for; report once a second what it waits for."""
        now = self._clock.monotonic_ns()
        if self._until_ns is None:
            self._until_ns, self._report_ns = now + round(_LIMIT_S * 1e9), now
        behind_s = self.behind_s()
        if not behind_s or now >= self._until_ns:
            return True
        if now >= self._report_ns:
            self._report_ns = now + _REPORT_NS
            left_s = (self._until_ns - now) * 1e-9
            self._report(
                f"waiting for {self.recorder}, which is {behind_s:.1f} s behind, for at most {left_s:.0f} s more; "
                "Ctrl-C does not wait"
            )
        return False

    def skip(self) -> None:
        """End the wait."""
        self._until_ns = self._clock.monotonic_ns()

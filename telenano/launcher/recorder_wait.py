"""A recorder that is behind at the end of a session: by how much, how long it is waited for, and what never came."""

from collections.abc import Callable, Mapping, Sequence

from telenano.launcher.liveness import NODE_TIMEOUT_S
from telenano.launcher.readiness import input_ages_s
from telenano.timing.clock import Clock
from telenano.wire.messages import NodeHealth

Report = Callable[[str], None]

# A recorder that keeps up is behind by milliseconds; this is more than a flush and a report of its health.
BEHIND_S = 1.0
_LIMIT_S = 20.0
_REPORT_NS = 1_000_000_000
# Messages that the other site sends this long after the end of a session still belong to it: the answers to the last
# samples.
_TAIL_NS = 500_000_000


def has_last(recorder: NodeHealth, ends_ns: Mapping[str, int]) -> bool:
    """Return whether a recorder has the last messages of publishers, of those that it receives.

    Args:
        recorder: The newest report of the recorder. The stamps of a publisher are of that one's clock there as well.
        ends_ns: The stamp of the last message of each publisher, a session/event [ns].
    """
    events = {row.src: row for row in recorder.inputs if row.topic == "session/event" and row.age_valid}
    received = {row.src for row in recorder.inputs if row.received}
    # The age is a number of seconds, whose digits end below a microsecond.
    return all(
        src in events and recorder.t_ns - round(events[src].age_s * 1e9) >= end_ns - 1000
        for src, end_ns in ends_ns.items()
        if src in received
    )


class RecorderWait:
    """Determines whether the recorder of a rig that continues has what was sent in a session, within a limit.

    The command to begin a new file reaches it before what still waits of the session, which would then be in the file
    after the session's.
    """

    def __init__(self, clock: Clock, recorder: str, publishes: Callable[[str], bool], report: Report) -> None:
        """Prepare to wait.

        Args:
            clock: The clock of the rig.
            recorder: The recorder that is waited for.
            publishes: Whether a node is at work now. The last message of any other node grows old without a fault of
                the recorder.
            report: Called with the lines of progress.
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
            # The recorder writes nothing either.
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


class LastMessages:
    """Determines whether a recorder has what the nodes of another site sent until the end of a session.

    Those nodes run on and publish no last message. Their reports reach this process as well: the first one that was
    sent after the session has to reach the recorder, and so has everything before it, which comes on the same
    connection. All stamps of a node are of its own clock, whatever that is.
    """

    def __init__(
        self, clock: Clock, recorder: str, senders: Sequence[str], alive: Callable[[str], bool], report: Report
    ) -> None:
        """Prepare to wait.

        Args:
            clock: The clock of the rig.
            recorder: The recorder that is waited for.
            senders: The nodes of the other site.
            alive: Whether a node is at work now.
            report: Called with the lines of progress.
        """
        self.recorder = recorder
        # sentences on what the recorder lacks, once the wait is over
        self.missing: list[str] = []
        self._senders = tuple(senders)
        self._clock = clock
        self._alive = alive
        self._report = report
        self._end_ns: int | None = None
        self._until_ns = self._report_ns = 0
        # For each sender: the least time from sending to reception, across two clocks; its uptime; the stamp of its
        # first report after the session; the stamp of the newest report that the recorder has.
        self._least_lag_ns: dict[str, int] = {}
        self._uptime_s: dict[str, float] = {}
        self._due_ns: dict[str, int] = {}
        self._recorded_ns: dict[str, int] = {}

    def record(self, health: NodeHealth) -> None:
        """Take note of a report of the recorder or of a sender."""
        if health.src == self.recorder:
            reports = [row for row in health.inputs if row.topic == "node/health" and row.age_valid]
            self._recorded_ns = {row.src: health.t_ns - round(row.age_s * 1e9) for row in reports}
        elif health.src in self._senders:
            self._record_sender(health)

    def over(self) -> bool:
        """Return whether there is no more to wait for; report once a second what it waits for."""
        now = self._clock.monotonic_ns()
        if self._end_ns is None:
            self._end_ns = self._clock.now_ns()
            self._until_ns, self._report_ns = now + round(_LIMIT_S * 1e9), now + _REPORT_NS
        waiting = self._outstanding()
        if waiting and now < self._until_ns and self._alive(self.recorder):
            if now >= self._report_ns:
                self._report_ns = now + _REPORT_NS
                left_s = (self._until_ns - now) * 1e-9
                self._report(
                    f"waiting for the last messages of {', '.join(waiting)} to reach {self.recorder}, for at most "
                    f"{left_s:.0f} s more; Ctrl-C does not wait"
                )
            return False
        self.missing = [self._lacks(node) for node in waiting]
        self.missing += [
            f"{node} was silent at the end of the session: what it sent last may be missing"
            for node in self._senders
            if node in self._least_lag_ns and not self._alive(node)
        ]
        return True

    def skip(self) -> None:
        """End the wait."""
        self._until_ns = self._clock.monotonic_ns()

    def _record_sender(self, health: NodeHealth) -> None:
        src, lag_ns = health.src, self._clock.now_ns() - health.t_ns
        if health.uptime_s < self._uptime_s.get(src, 0.0):
            # The node was started again, with a clock that may be another one.
            self._least_lag_ns.pop(src, None)
        self._uptime_s[src] = health.uptime_s
        least_ns = self._least_lag_ns[src] = min(self._least_lag_ns.get(src, lag_ns), lag_ns)
        if self._end_ns is not None and health.t_ns + least_ns >= self._end_ns + _TAIL_NS:
            self._due_ns.setdefault(src, health.t_ns)

    def _outstanding(self) -> list[str]:
        """Return the senders at work, of those that the recorder receives, whose last messages it lacks."""
        return [
            node
            for node in self._senders
            if self._alive(node) and node in self._recorded_ns and not self._has_last(node)
        ]

    def _has_last(self, node: str) -> bool:
        due_ns = self._due_ns.get(node)
        return due_ns is not None and self._recorded_ns[node] >= due_ns

    def _lacks(self, node: str) -> str:
        now_ns = self._clock.now_ns() - self._least_lag_ns.get(node, 0)
        return (
            f"what {node} sent in the last {(now_ns - self._recorded_ns[node]) * 1e-9:.1f} s had not reached "
            f"{self.recorder} when the wait for it was over"
        )

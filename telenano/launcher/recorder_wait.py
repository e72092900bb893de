"""Waits at the end of a session for a recorder that is behind, and states which messages it never received."""

from collections.abc import Callable, Mapping, Sequence

from telenano.launcher.liveness import NODE_TIMEOUT_S
from telenano.launcher.readiness import input_ages_s
from telenano.timing.clock import Clock
from telenano.wire.messages import NodeHealth

Report = Callable[[str], None]

# Least lag at which a recorder counts as behind [s]. One that keeps up lags by milliseconds; a flush and the interval
# of its reports take less than this.
BEHIND_S = 1.0
_LIMIT_S = 20.0
_REPORT_NS = 1_000_000_000
# Time after the end of a session for which messages of the other site still belong to it [ns]: they answer the last
# samples.
_TAIL_NS = 500_000_000


def has_last(recorder: NodeHealth, ends_ns: Mapping[str, int]) -> bool:
    """Return whether a recorder has the last message of each publisher that it receives.

    Args:
        recorder: The newest report of the recorder. The ages in it follow the clock of each publisher.
        ends_ns: The stamp of the last message of each publisher, a session/event [ns], by that publisher's clock.
    """
    events = {row.src: row for row in recorder.inputs if row.topic == "session/event" and row.age_valid}
    received = {row.src for row in recorder.inputs if row.received}
    # The age is a float of seconds, so the stamp computed from it may be off by rounding: allow 1 us.
    return all(
        src in events and recorder.t_ns - round(events[src].age_s * 1e9) >= end_ns - 1000
        for src, end_ns in ends_ns.items()
        if src in received
    )


class RecorderWait:
    """Waits, up to a limit, until the recorder of a rig that keeps running has all messages of a session.

    Without the wait, the command to begin a new file would overtake queued messages of the session, which would then be
    written to the next file.
    """

    def __init__(self, clock: Clock, recorder: str, publishes: Callable[[str], bool], report: Report) -> None:
        """Prepare to wait.

        Args:
            clock: The clock of the rig.
            recorder: The recorder to wait for.
            publishes: Returns whether a node is publishing now. The messages of any other node grow old without a fault
                of the recorder.
            report: Called with lines on the progress.
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
        """Record the age of the newest inputs from a report of the recorder; other reports are ignored."""
        if health.src == self.recorder:
            self._received_ns = self._clock.monotonic_ns()
            ages = (age_s for (_, src), age_s in input_ages_s(health).items() if self._publishes(src))
            self._lag_s = max(ages, default=0.0)

    def behind_s(self) -> float:
        """Return the lag of the recorder [s]; 0 if it never reported or keeps up."""
        if self._received_ns is None:
            return 0.0
        silence_s = (self._clock.monotonic_ns() - self._received_ns) * 1e-9
        if silence_s >= NODE_TIMEOUT_S:
            # A recorder that does not report does not write either.
            return silence_s
        return self._lag_s if self._lag_s >= BEHIND_S else 0.0

    def over(self) -> bool:
        """Return whether the wait is over, by catching up or after 20 s; report once a second while it is not."""
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
    """Waits until a recorder has the messages that the nodes of another site sent until the end of a session.

    Those nodes keep running, so no message marks their last one. Instead, the first health report that a node sent
    after the session has to reach the recorder; all earlier messages precede it on the same connection. All stamps of a
    node are compared by that node's own clock.
    """

    def __init__(
        self, clock: Clock, recorder: str, senders: Sequence[str], alive: Callable[[str], bool], report: Report
    ) -> None:
        """Prepare to wait.

        Args:
            clock: The clock of the rig.
            recorder: The recorder to wait for.
            senders: The nodes of the other site.
            alive: Returns whether a node is publishing now.
            report: Called with lines on the progress.
        """
        self.recorder = recorder
        # Sentences on the messages that the recorder lacks, once the wait is over.
        self.missing: list[str] = []
        self._senders = tuple(senders)
        self._clock = clock
        self._alive = alive
        self._report = report
        self._end_ns: int | None = None
        self._until_ns = self._report_ns = 0
        # For each sender: least difference of reception and sending, by two clocks [ns]; uptime [s]; stamp of its first
        # report after the session [ns]; stamp of its newest report that the recorder has [ns].
        self._least_lag_ns: dict[str, int] = {}
        self._uptime_s: dict[str, float] = {}
        self._due_ns: dict[str, int] = {}
        self._recorded_ns: dict[str, int] = {}

    def record(self, health: NodeHealth) -> None:
        """Record a report of the recorder or of a sender; others are ignored."""
        if health.src == self.recorder:
            reports = [row for row in health.inputs if row.topic == "node/health" and row.age_valid]
            self._recorded_ns = {row.src: health.t_ns - round(row.age_s * 1e9) for row in reports}
        elif health.src in self._senders:
            self._record_sender(health)

    def over(self) -> bool:
        """Return whether the wait is over, which then determines `missing`; report once a second while it is not."""
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
            # The node was restarted, perhaps with another clock.
            self._least_lag_ns.pop(src, None)
        self._uptime_s[src] = health.uptime_s
        least_ns = self._least_lag_ns[src] = min(self._least_lag_ns.get(src, lag_ns), lag_ns)
        if self._end_ns is not None and health.t_ns + least_ns >= self._end_ns + _TAIL_NS:
            self._due_ns.setdefault(src, health.t_ns)

    def _outstanding(self) -> list[str]:
        """Return the publishing senders that the recorder receives, and whose last messages it lacks."""
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

"""Supervision of the processes of a rig on this machine: start, reports of exits and hangs, restarts, and stop."""

from collections.abc import Callable, Sequence

from telenano.launcher.processes import Children, StopObserver
from telenano.launcher.restart_policy import ProcessExit, RestartTracker, describe_exit
from telenano.launcher.watchdog import Finding, Watchdog
from telenano.runtime.wiring.main import EXIT_BAD_START, EXIT_DIED
from telenano.timing.clock import Clock
from telenano.wire.messages import NodeHealth, Scalar
from telenano.wire.nodes import RELAY, name_of

# Called with level, sentence, and the facts of a session/event.
Report = Callable[..., None]


class Supervisor:
    """Supervises the child processes; `failure`: the reason why the rig cannot continue, empty while it can."""

    def __init__(
        self,
        clock: Clock,
        nodes: Sequence[str],
        children: Children,
        watchdog: Watchdog | None = None,
        beside: Sequence[str] = (),
    ) -> None:
        """Prepare to supervise; nothing is started yet.

        Args:
            clock: The clock of the rig.
            nodes: The nodes in the order of their start; none if all of them run elsewhere.
            children: Starts and ends processes.
            watchdog: Detects nodes that hang; without it only processes that end are restarted.
            beside: Further processes without which the rig continues, such as the operator's page.
        """
        self.nodes = tuple(nodes)
        self.failure = ""
        # Whether the failure is a node that cannot start with its configuration.
        self.bad_start = False
        self._beside = tuple(beside)
        self._tracker = RestartTracker(clock, nodes, beside=beside)
        self._children = children
        self._watchdog = watchdog

    def launch(self, report: Report) -> None:
        """Start all processes; OSError if one of the nodes cannot be started."""
        for node in (*self.nodes, *self._beside):
            self._start(node, report, is_first=True)

    def handle_exits(self, report: Report) -> list[str]:
        """Collect the processes that ended, report the decision for each, and return their nodes."""
        ended = self._children.reap()
        if self._watchdog is not None:
            self._watchdog.forget(ended)
        for node, exit_code in ended.items():
            self._handle_exit(self._tracker.record_exit(node, exit_code), report)
        return list(ended)

    def record_health(self, health: NodeHealth, report: Report) -> None:
        """Record a report of a node; the end of a reported silence is reported too."""
        if self._watchdog is not None:
            is_stopping = health.state == "stopping"
            _tell(self._watchdog.record_report(health.src, health.pid, is_stopping=is_stopping), report)

    def handle_hangs(self, report: Report) -> None:
        """Report silent nodes, and kill those that hang; they are then restarted like any that died."""
        if self._watchdog is not None:
            hung = self._watchdog.check()
            _tell(hung, report)
            for finding in hung:
                if finding.kind == "hung":
                    self._children.kill(finding.node)

    def restart_due(self, report: Report) -> None:
        """Start the nodes whose restart is due; a restarted device node begins in its safe state."""
        for node in self._tracker.due():
            if (process_id := self._start(node, report)) is not None:
                report("warning", f"{node} was started again", about_node=node, pid=process_id)

    def restarts(self) -> dict[str, int]:
        return {node: self._tracker.restarts(node) for node in self.nodes}

    def log_tail_of(self, node: str) -> str:
        """Return the last lines of a node's log with the path of the file."""
        tail = self._children.log_tail(node) or "(it wrote nothing)"
        return f"last lines of {node}, from {self._children.log_path(node)}:\n{tail}"

    def last_alarm_of_relay(self) -> str:
        """Return the last log entry of the process that reaches the other site by a relay, if it is an alarm."""
        for node in (beside for beside in self._beside if name_of(beside) == RELAY):
            level, _, text = self._children.log_tail(node).rpartition("\n")[2].partition(": ")
            if level in ("warning", "error"):
                return f"{node}: {text}"
        return ""

    def stop(self, observer: StopObserver | None = None) -> None:
        """Stop all nodes and report the progress to an observer, if any."""
        self._children.stop(observer or StopObserver())

    def _start(self, node: str, report: Report, *, is_first: bool = False) -> int | None:
        """Start a process and return its id; if that fails, report it, schedule another attempt, and return None.

        The first start of a node raises OSError instead, because there is no rig yet.
        """
        self._tracker.record_start(node)
        try:
            process_id = self._children.start(node)
        except OSError as error:
            if is_first and node not in self._beside:
                raise
            ended = self._tracker.record_exit(node, EXIT_DIED)
            self._note_exit(ended, f"{node} cannot be started: {error}: {ended.verdict}", report)
            return None
        if self._watchdog is not None:
            self._watchdog.record_start(node, process_id)
        return process_id

    def _handle_exit(self, ended: ProcessExit, report: Report) -> None:
        tail = self._children.log_tail(ended.node) if ended.node in self._beside and ended.exit_code > 0 else ""
        last = f" ({tail.splitlines()[-1].strip()})" if tail else ""
        text = f"{ended.node} {_exit_text(ended)}{last}: {ended.verdict}"
        self._note_exit(ended, text, report, exit_code=ended.exit_code, life_s=ended.life_s)

    def _note_exit(self, ended: ProcessExit, text: str, report: Report, **facts: Scalar) -> None:
        """Report the end of a process or a failed start; the first node that is given up ends the rig."""
        report("error" if ended.given_up else "warning", text, about_node=ended.node, **facts)
        if ended.given_up and not self.failure and ended.node not in self._beside:
            # The first failure is the cause; later ones are its consequences.
            self.bad_start = ended.exit_code == EXIT_BAD_START
            self.failure = "\n".join([text, *self._history(ended), self.log_tail_of(ended.node)])

    def _history(self, ended: ProcessExit) -> list[str]:
        """Return lines on earlier ends of the node, and on other restarted nodes, which point to a common cause."""
        exits = self._tracker.exits(ended.node)
        lines = [f"its last {len(exits)} exits: {', '.join(map(_exit_text, exits))}"] if len(exits) > 1 else []
        others = [f"{node} ({count})" for node, count in self.restarts().items() if count and node != ended.node]
        if others:
            lines.append(f"other nodes that were started again: {', '.join(others)}")
        return lines


def _tell(findings: Sequence[Finding], report: Report) -> None:
    for finding in findings:
        level = "info" if finding.kind == "back" else "error" if finding.kind == "hung" else "warning"
        facts = {"about_node": finding.node} if finding.node else {}
        report(level, finding.text, **facts, state=finding.kind, silence_s=finding.silence_s)


def _exit_text(ended: ProcessExit) -> str:
    return f"{describe_exit(ended.exit_code)} after {ended.life_s:.1f} s"

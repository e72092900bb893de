"""Looks after the processes of this machine: starts them, tells when one dies, and starts it again."""

from collections.abc import Callable, Sequence

from services.launcher.processes import Children
from services.launcher.restart_policy import ProcessExit, RestartTracker, ending
from services.runtime.clock import Clock

# level, sentence, and the facts of a session/event
Say = Callable[..., None]


class Supervisor:
    """The nodes that are children of this process; `failure` says why the rig cannot go on, empty while it can."""

    def __init__(self, clock: Clock, nodes: Sequence[str], children: Children) -> None:
        """Take the nodes in the order of their start; none where all are somebody else's."""
        self.nodes = tuple(nodes)
        self.supervisor = RestartTracker(clock, nodes)
        self.failure = ""
        self._children = children

    def launch(self) -> None:
        """Start every node for the first time."""
        for node in self.nodes:
            self._start(node)

    def look(self, say: Say) -> list[str]:
        """Take note of deaths, and say of each what becomes of it; gives the nodes that died."""
        ended = self._children.reap()
        for node, exit_code in ended.items():
            self._handle_exit(self.supervisor.died(node, exit_code), say)
        return list(ended)

    def restart_due(self, say: Say) -> None:
        """Start again what is due; a device comes back in its safe state."""
        for node in self.supervisor.due():
            process_id = self._start(node)
            say("warning", f"{node} was started again", about_node=node, pid=process_id)

    def restarts(self) -> dict[str, int]:
        """Give how often each node was started again."""
        return {node: self.supervisor.restarts(node) for node in self.nodes}

    def log_tail_of(self, node: str) -> str:
        """Give what a node wrote last, and where the rest of it is."""
        tail = self._children.log_tail(node) or "(it wrote nothing)"
        return f"last lines of {node}, from {self._children.log_path(node)}:\n{tail}"

    def stop(self) -> None:
        """End every process, in order."""
        self._children.stop()

    def _start(self, node: str) -> int:
        process_id = self._children.start(node)
        self.supervisor.started(node)
        return process_id

    def _handle_exit(self, death: ProcessExit, say: Say) -> None:
        text = f"{death.node} {ending(death.exit_code)} after {death.life_s:.1f} s: {death.verdict}"
        level = "error" if death.given_up else "warning"
        say(level, text, about_node=death.node, exit_code=death.exit_code, life_s=death.life_s)
        if death.given_up and not self.failure:
            # the first failure is the cause, what follows are its consequences
            self.failure = "\n".join([text, *self._history(death), self.log_tail_of(death.node)])

    def _history(self, death: ProcessExit) -> list[str]:
        """Say how the node died before, and which others did: a common cause shows in several."""
        deaths = self.supervisor.deaths(death.node)
        lines = [f"its {len(deaths)} deaths: " + ", ".join(_short(past) for past in deaths)] if len(deaths) > 1 else []
        others = [f"{node} ({count})" for node, count in self.restarts().items() if count and node != death.node]
        if others:
            lines.append(f"others that were started again: {', '.join(others)}")
        return lines


def _short(death: ProcessExit) -> str:
    return f"{ending(death.exit_code)} after {death.life_s:.1f} s"

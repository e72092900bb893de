"""The deferred tasks of several nodes in one process, which share its idle gap."""

from telenano.runtime.loop.deferred import PATIENCE_NS, Deferred, DeferredTasks, Task
from telenano.timing.clock import NEVER_NS, Clock


class SharedTasks(DeferredTasks):
    """The tasks of all nodes of a process; the loop of the process runs each as a task of its node."""

    def __init__(self, clock: Clock) -> None:
        super().__init__(clock)
        self.owners: dict[Task, str] = {}

    def of(self, key: str) -> list[Deferred]:
        """Return the waiting tasks of a node."""
        return [task for task in self._waiting if self.owners[task.run] == key]

    def remove(self, task: Deferred) -> None:
        """Remove a waiting task."""
        self._waiting.remove(task)
        self._schedule(self._now_ns())


class NodeTasks(DeferredTasks):
    """The tasks of one node, as a part of the tasks of its process, which runs them.

    Args:
        shared: The tasks of the process.
        key: The node as node@site.
        clock: The clock of the process.
    """

    def __init__(self, shared: SharedTasks, key: str, clock: Clock) -> None:
        # `due_ns` stays NEVER_NS, so that the loop of the node itself never runs a task.
        super().__init__(clock)
        self._shared, self._key = shared, key

    def add(self, task: Task, *, is_turn: bool = False, within_ns: int = PATIENCE_NS) -> None:
        self._shared.owners[task] = self._key
        self._shared.add(task, is_turn=is_turn, within_ns=within_ns)

    def note_event(self, begin_ns: int, end_ns: int, *, is_last: bool) -> None:
        """Do nothing: the loop of the process notes its own events."""

    def note_run(self, task: Task, begin_ns: int, end_ns: int, *, met: bool) -> None:
        self._shared.note_run(task, begin_ns, end_ns, met=met)

    @property
    def has_turns(self) -> bool:
        return any(task.is_turn and task.latest_ns < NEVER_NS for task in self._shared.of(self._key))

    def forget_unneeded(self) -> None:
        for task in self._shared.of(self._key):
            if task.latest_ns == NEVER_NS:
                self._shared.remove(task)

    def take_turn(self) -> Task | None:
        turn = next((task for task in self._shared.of(self._key) if task.is_turn), None)
        if turn is None:
            return None
        self._shared.remove(turn)
        return turn.run

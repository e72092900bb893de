"""Deferred tasks: work of a node that need not be done at once, run in the idle gaps of its loop."""

from collections.abc import Callable
from typing import NamedTuple

from telenano.timing.clock import NEVER_NS, Clock

Task = Callable[[], object]
# A task that has waited for this time is run even without a gap.
PATIENCE_NS = 20_000_000
# After this time without an event, the next one cannot be predicted, and every new task is due at once.
_IDLE_NS = 5_000_000
# A running mean moves by one part in this number of the difference from a new measurement.
_MEAN_SHARE = 8


class Deferred(NamedTuple):
    """A waiting task.

    `is_turn`: the outputs of the node depend on the task, so its run is a turn in the journal. `latest_ns`: the time at
    which it is run even without a gap, on the monotonic clock; NEVER_NS for an optional task, run only in a gap.
    """

    run: Task
    is_turn: bool
    latest_ns: int


class Gap(NamedTuple):
    """The time from one event of a process to the next, while other processes work on the tick.

    All times on the monotonic clock [ns]. `begin_ns`: end of the handling of the event; `length_ns`: mean length of a
    gap, 0 if unknown or if no gap begins with this event; `free_ns`: time from which the processor is free for a task,
    NEVER_NS if it is no longer.
    """

    begin_ns: int
    length_ns: int
    free_ns: int

    def fits_from(self, takes_ns: int, now_ns: int, next_ns: int) -> int:
        """Return the time from which a task can be run in this gap, NEVER_NS if it does not fit any more [ns].

        A task fits if it ends before the last quarter. A longer task may begin in the first half, because it would
        delay a tick at any other time as well.

        Args:
            takes_ns: Duration of the task [ns].
            now_ns: The present time on the monotonic clock [ns].
            next_ns: The next deadline of the node, before which the task has to end [ns].
        """
        begin_ns = max(self.free_ns, now_ns)
        end_ns = begin_ns + takes_ns
        is_early = begin_ns <= self.begin_ns + self.length_ns // 2
        is_short = end_ns <= self.begin_ns + self.length_ns - self.length_ns // 4
        return begin_ns if (is_early or is_short) and end_ns <= next_ns else NEVER_NS


def gap_after(end_ns: int, length_ns: int) -> Gap:
    """Return the gap after an event whose handling ended at `end_ns`, with its mean length [ns].

    The first quarter is left to processes that the messages just sent have woken up, perhaps on the same processor.
    """
    return Gap(end_ns, length_ns, end_ns + length_ns // 4 if length_ns else NEVER_NS)


class DeferredTasks:
    """The tasks of one loop, in the order in which they were added.

    A report takes a third of a tick and becomes due at any time. Run just before a tick, it would make that tick late,
    and a tick that is late by a period collides with the next one. So a task waits for an idle gap between two events
    of this process, in which other processes work on the tick. The length of the gap and the duration of each task are
    running means of measurements. Each gap has room for one task, besides optional ones, in its middle half
    (`Gap.fits_from`); the last quarter is left free for a tick that comes early.
    """

    def __init__(self, clock: Clock) -> None:
        self._now_ns = clock.monotonic_ns
        self._waiting: list[Deferred] = []
        # The time at which a task is due, on the monotonic clock [ns].
        self.due_ns = NEVER_NS
        # Mean duration of each task, and mean length of a gap [ns].
        self._takes_ns: dict[Task, int] = {}
        self._gap_ns: int | None = None
        self._begin(Gap(-NEVER_NS, 0, NEVER_NS), in_gap=False)

    def _begin(self, gap: Gap, *, in_gap: bool) -> None:
        """Begin the time after an event; `in_gap`: it is an idle gap, whose length is measured."""
        self._gap, self._in_gap = gap, in_gap
        # Begin of the task during which the next event came, if any, and the next deadline.
        self._met_ns = self._next_ns = NEVER_NS
        # Whether a task has been run in the gap.
        self._is_used = False

    def add(self, task: Task, *, is_turn: bool = False, within_ns: int = PATIENCE_NS) -> None:
        """Add a task; a task that already waits keeps its place.

        Args:
            task: The callable, equal each time, because it identifies the task.
            is_turn: Whether the outputs of the node depend on the task.
            within_ns: Time after which the task is run even without an idle gap [ns]; NEVER_NS: only in a gap.
        """
        if any(task == waiting.run for waiting in self._waiting):
            return
        now_ns = self._now_ns()
        is_idle = now_ns - self._gap.begin_ns >= _IDLE_NS
        self._waiting.append(Deferred(task, is_turn, now_ns if is_idle else min(now_ns + within_ns, NEVER_NS)))
        self._schedule(now_ns)

    def note_event(self, begin_ns: int, end_ns: int, *, is_last: bool) -> None:
        """Measure the gap before an event, and begin the one after it.

        Args:
            begin_ns: Time at which a message or deadline came, on the monotonic clock [ns].
            end_ns: Time at which its handling ended [ns].
            is_last: Whether the longest time in which other processes work on the tick begins now.
        """
        gap_ns = min(begin_ns, self._met_ns) - self._gap.begin_ns
        if self._in_gap and gap_ns < _IDLE_NS:
            self._gap_ns = _mean(self._gap_ns, gap_ns)
        self._begin(gap_after(end_ns, self._gap_ns or 0 if is_last else 0), in_gap=is_last)
        if self._waiting:
            self._schedule(end_ns)

    def take(self, now_ns: int, next_ns: int = NEVER_NS) -> Deferred | None:
        """Remove and return the task to run now, or None.

        It is the first task if any task has waited too long, else the next task if it fits into the gap. The others
        stay in the queue while it runs, because the task that ends a batch of the journal checks it.

        Args:
            now_ns: The present time on the monotonic clock [ns].
            next_ns: The next deadline of the node, before which the task has to end [ns].
        """
        self._next_ns = next_ns
        is_overdue = any(task.latest_ns <= now_ns for task in self._waiting)
        task = self._waiting[0] if is_overdue else self._next() if self._fits_at(now_ns) == now_ns else None
        if task is not None:
            self._waiting.remove(task)
            self._is_used |= not is_overdue and task.latest_ns < NEVER_NS
        self._schedule(now_ns)
        return task

    def take_turn(self) -> Task | None:
        """Remove and return the first task that is a turn of the node, at any time; None if there is none."""
        turn = next((task for task in self._waiting if task.is_turn), None)
        if turn is None:
            return None
        self._waiting.remove(turn)
        self._schedule(self._now_ns())
        return turn.run

    @property
    def has_turns(self) -> bool:
        """Whether a task waits that is a turn of the node and not optional."""
        return any(task.is_turn and task.latest_ns < NEVER_NS for task in self._waiting)

    def forget_unneeded(self) -> None:
        """Remove the optional tasks."""
        self._waiting = [task for task in self._waiting if task.latest_ns < NEVER_NS]

    def note_run(self, task: Task, begin_ns: int, end_ns: int, *, met: bool) -> None:
        """Record the duration of a task; before the next one, the processor is left to others for half of it.

        Args:
            task: The task that was run.
            begin_ns: Begin of the run, on the monotonic clock [ns].
            end_ns: End of the run [ns].
            met: Whether a message has arrived meanwhile, so that the gap had ended before.
        """
        taken_ns = end_ns - begin_ns
        self._takes_ns[task] = _mean(self._takes_ns.get(task), taken_ns)
        if met:
            self._met_ns = begin_ns
        free_ns = NEVER_NS if met else max(self._gap.free_ns, end_ns + taken_ns // 2)
        self._gap = self._gap._replace(free_ns=free_ns)
        self._schedule(end_ns)

    def _next(self) -> Deferred | None:
        """Return the first task that may be run in this gap: only an optional one if another has been run."""
        waiting = (task for task in self._waiting if not self._is_used or task.latest_ns == NEVER_NS)
        return next(waiting, None)

    def _fits_at(self, now_ns: int) -> int:
        """Return the time from which the next task can be run in this gap, NEVER_NS if none fits any more [ns]."""
        task = self._next()
        return NEVER_NS if task is None else self._gap.fits_from(self._takes_ns.get(task.run, 0), now_ns, self._next_ns)

    def _schedule(self, now_ns: int) -> None:
        latest_ns = min((task.latest_ns for task in self._waiting), default=NEVER_NS)
        self.due_ns = min(latest_ns, self._fits_at(now_ns))


def _mean(known_ns: int | None, measured_ns: int) -> int:
    """Return the running mean, updated from the known one (None at first) by a measurement [ns]."""
    return measured_ns if known_ns is None else known_ns + (measured_ns - known_ns) // _MEAN_SHARE

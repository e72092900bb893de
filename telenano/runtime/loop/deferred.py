"""Deferred tasks: what a node has to do and need not do at once, run in the idle gaps of its loop."""

from collections.abc import Callable
from typing import NamedTuple

from telenano.timing.clock import NEVER_NS, Clock

Task = Callable[[], object]
# A task that has waited for this time is run anyway.
PATIENCE_NS = 20_000_000
# After this time without an event nothing is known of the next one, and every task is due at once.
_IDLE_NS = 5_000_000
# A mean follows its measurements by this share.
_MEAN_SHARE = 8


class Deferred(NamedTuple):
    """A task that waits.

    `is_turn`: the outputs of the node depend on it, so that its run is a turn in the journal. `latest_ns`: when it is
    run anyway, on the monotonic clock; NEVER_NS of a task that is not needed, only better done in a gap.
    """

    run: Task
    is_turn: bool
    latest_ns: int


class Gap(NamedTuple):
    """The time from an event of a process to the next one, while the tick is with others.

    `begin_ns`: when the event was dealt with; `length_ns`: how long a gap lasts in the mean, 0 where that is not known
    or the event began none; `free_ns`: from when on the processor is free for a task, NEVER_NS if it is not any more.
    """

    begin_ns: int
    length_ns: int
    free_ns: int

    def fits_from(self, takes_ns: int, now_ns: int, next_ns: int) -> int:
        """Return from when on a task can be run in this gap [ns], NEVER_NS if it does not fit in any more.

        It fits where it ends in the third quarter. One that is too long for that begins in the second, because it would
        delay a tick anywhere else as well.

        Args:
            takes_ns: How long the task takes.
            now_ns: The present, on the monotonic clock.
            next_ns: When the next deadline of the node comes, before which the task has to be over.
        """
        begin_ns = max(self.free_ns, now_ns)
        end_ns = begin_ns + takes_ns
        is_early = begin_ns <= self.begin_ns + self.length_ns // 2
        is_short = end_ns <= self.begin_ns + self.length_ns - self.length_ns // 4
        return begin_ns if (is_early or is_short) and end_ns <= next_ns else NEVER_NS


def gap_after(end_ns: int, length_ns: int) -> Gap:
    """Return the gap after an event that was dealt with at end_ns [ns].

    Its first quarter belongs to processes that what was just sent has woken up, on the same processor perhaps.
    """
    return Gap(end_ns, length_ns, end_ns + length_ns // 4 if length_ns else NEVER_NS)


class DeferredTasks:
    """The tasks of one loop, in the order in which they were added.

    A report takes as long as a third of a tick and becomes due at any time. In front of a tick it makes that tick late,
    and a tick that is late by a period meets the next one. So a task waits for an idle gap, in which the tick is with
    others, from one event of this process to the next. How long the gap is and how long each task takes are means of
    what the loop has measured. Each gap takes one task, besides those that are not needed, in its middle half
    (`Gap.fits_from`): its last quarter belongs to a tick that comes early.
    """

    def __init__(self, clock: Clock) -> None:
        self._now_ns = clock.monotonic_ns
        self._waiting: list[Deferred] = []
        # when there is something to do, on the monotonic clock [ns]
        self.due_ns = NEVER_NS
        # mean time that each task takes, and mean length of a gap [ns]
        self._takes_ns: dict[Task, int] = {}
        self._gap_ns: int | None = None
        self._begin(Gap(-NEVER_NS, 0, NEVER_NS), in_gap=False)

    def _begin(self, gap: Gap, *, in_gap: bool) -> None:
        """Begin the time after an event; `in_gap`: a gap, whose length is measured."""
        self._gap, self._in_gap = gap, in_gap
        # When the next event came, if a task did not let it in, and when the next deadline comes.
        self._met_ns = self._next_ns = NEVER_NS
        # whether the gap has taken its task
        self._is_used = False

    def add(self, task: Task, *, is_turn: bool = False, within_ns: int = PATIENCE_NS) -> None:
        """Add a task, the same callable each time; one that waits keeps its place.

        Args:
            task: What to run.
            is_turn: Whether the outputs of the node depend on it.
            within_ns: After this time it is run even if there was no idle gap; NEVER_NS: only in one.
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
            begin_ns: When a message or deadline came, on the monotonic clock.
            end_ns: When it was dealt with.
            is_last: Whether the tick is then with others for the longest time.
        """
        gap_ns = min(begin_ns, self._met_ns) - self._gap.begin_ns
        if self._in_gap and gap_ns < _IDLE_NS:
            self._gap_ns = _mean(self._gap_ns, gap_ns)
        self._begin(gap_after(end_ns, self._gap_ns or 0 if is_last else 0), in_gap=is_last)
        if self._waiting:
            self._schedule(end_ns)

    def take(self, now_ns: int, next_ns: int = NEVER_NS) -> Deferred | None:
        """Return what is to be run now: the first task if one has waited for too long, or if it fits into the gap.

        The others still wait while it runs, because the task that ends a batch of the journal asks which ones do.

        Args:
            now_ns: The time on the monotonic clock.
            next_ns: When the next deadline of the node comes, before which the task has to be over.
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
        """Return the first task that is a turn of the node, whatever the time is; None if there is none."""
        turn = next((task for task in self._waiting if task.is_turn), None)
        if turn is None:
            return None
        self._waiting.remove(turn)
        self._schedule(self._now_ns())
        return turn.run

    @property
    def has_turns(self) -> bool:
        """Whether a task waits that is a turn of the node, and needed."""
        return any(task.is_turn and task.latest_ns < NEVER_NS for task in self._waiting)

    def forget_unneeded(self) -> None:
        """Forget the tasks that are not needed."""
        self._waiting = [task for task in self._waiting if task.latest_ns < NEVER_NS]

    def note_run(self, task: Task, begin_ns: int, end_ns: int, *, met: bool) -> None:
        """Note how long a task took; the next one leaves the processor to others for half as long.

        Args:
            task: The task that was run.
            begin_ns: When it began, on the monotonic clock.
            end_ns: When it ended.
            met: A message has come meanwhile, so the gap was over before.
        """
        taken_ns = end_ns - begin_ns
        self._takes_ns[task] = _mean(self._takes_ns.get(task), taken_ns)
        if met:
            self._met_ns = begin_ns
        free_ns = NEVER_NS if met else max(self._gap.free_ns, end_ns + taken_ns // 2)
        self._gap = self._gap._replace(free_ns=free_ns)
        self._schedule(end_ns)

    def _next(self) -> Deferred | None:
        """Return the first task that this gap may take."""
        waiting = (task for task in self._waiting if not self._is_used or task.latest_ns == NEVER_NS)
        return next(waiting, None)

    def _fits_at(self, now_ns: int) -> int:
        """Return from when on the next task can be run in this gap [ns], NEVER_NS if none fits in any more."""
        task = self._next()
        return NEVER_NS if task is None else self._gap.fits_from(self._takes_ns.get(task.run, 0), now_ns, self._next_ns)

    def _schedule(self, now_ns: int) -> None:
        latest_ns = min((task.latest_ns for task in self._waiting), default=NEVER_NS)
        self.due_ns = min(latest_ns, self._fits_at(now_ns))


def _mean(known_ns: int | None, measured_ns: int) -> int:
    """Return the mean that continues from the one known so far, None at first [ns]."""
    return measured_ns if known_ns is None else known_ns + (measured_ns - known_ns) // _MEAN_SHARE

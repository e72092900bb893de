"""Deferred tasks: idle gaps as they are measured, tasks that fit into them, and what is run without one."""

from collections.abc import Callable

import pytest

from telenano.runtime.loop.deferred import PATIENCE_NS, DeferredTasks, gap_after
from telenano.testing import VirtualClock
from telenano.timing.clock import NEVER_NS

US, MS = 1_000, 1_000_000


class Loop:
    """A queue, and tasks that note when they are run."""

    def __init__(self) -> None:
        self.clock = VirtualClock(start_ns=10 * MS)
        self.tasks = DeferredTasks(self.clock)
        self.run: list[tuple[str, int]] = []
        self._named: dict[str, Callable[[], object]] = {}

    def named(self, name: str) -> Callable[[], object]:
        return self._named.setdefault(name, lambda: self.run.append((name, self.clock.monotonic_ns())))

    def add(self, *names: str, is_turn: bool = False, within_ns: int = PATIENCE_NS) -> None:
        for name in names:
            self.tasks.add(self.named(name), is_turn=is_turn, within_ns=within_ns)

    def event(self, takes_ns: int = 0, *, is_last: bool = True) -> None:
        begin_ns = self.clock.monotonic_ns()
        self.clock.advance_ns(takes_ns)
        self.tasks.note_event(begin_ns, begin_ns + takes_ns, is_last=is_last)

    def after(self, duration_ns: int) -> "Loop":
        self.clock.advance_ns(duration_ns)
        return self

    def ticks(self, count: int, period_ns: int = MS) -> None:
        """Let ticks come; the last one is now."""
        for _ in range(count):
            self.after(period_ns).event()

    def took(self, name: str, duration_ns: int, *, met: bool = False) -> None:
        """Note that a task has taken so long until now."""
        now_ns = self.clock.monotonic_ns()
        self.tasks.note_run(self.named(name), now_ns - duration_ns, now_ns, met=met)

    def take(self, next_ns: int = NEVER_NS) -> list[str]:
        """Give what is run now: all that have waited for too long, and those before them, or else one."""
        now_ns, names, taken = (
            self.clock.monotonic_ns(),
            {task: name for name, task in self._named.items()},
            list[str](),
        )
        while (task := self.tasks.take(now_ns, next_ns)) is not None:
            taken.append(names[task.run])
            if not any(waiting.latest_ns <= now_ns for waiting in self.tasks._waiting):
                break
        return taken

    @property
    def due_in_ns(self) -> int:
        """Time until something is due, -1 for never."""
        due_ns = self.tasks.due_ns
        return -1 if due_ns == NEVER_NS else due_ns - self.clock.monotonic_ns()


@pytest.fixture
def loop() -> Loop:
    return Loop()


@pytest.fixture
def ticking() -> Loop:
    loop = Loop()
    loop.ticks(8)
    return loop


def test_without_events_everything_is_due_at_once_in_its_order(loop: Loop) -> None:
    assert loop.due_in_ns == -1
    assert loop.take() == []
    loop.add("a", "b")
    loop.add("b", "c", "a")
    assert loop.due_in_ns == 0
    assert loop.take() == ["a", "b", "c"]
    assert (loop.due_in_ns, loop.take()) == (-1, [])


def test_a_loop_is_idle_five_milliseconds_after_its_last_event(ticking: Loop) -> None:
    ticking.after(5 * MS - 1).add("a")
    assert ticking.due_in_ns == PATIENCE_NS
    # the first one has waited for as long
    ticking.after(1).add("b")
    assert (ticking.due_in_ns, ticking.take(), ticking.due_in_ns) == (0, ["a", "b"], -1)


def test_a_task_is_run_when_a_quarter_of_the_gap_is_over(ticking: Loop) -> None:
    ticking.add("a")
    assert ticking.due_in_ns == 250 * US
    assert ticking.after(250 * US - 1).take() == []
    assert ticking.due_in_ns == 1
    assert ticking.after(1).take() == ["a"]
    assert ticking.due_in_ns == -1


def test_the_gap_begins_where_the_event_was_dealt_with(ticking: Loop) -> None:
    for _ in range(100):
        ticking.after(800 * US).event(takes_ns=200 * US)
    ticking.add("a")
    # 0.8 ms, as nearly as a mean comes there
    assert abs(ticking.due_in_ns - 200 * US) <= 2


def test_a_task_that_comes_within_the_gap_is_run_at_once_and_after_it_in_the_next(ticking: Loop) -> None:
    ticking.after(750 * US).add("a")
    assert (ticking.due_in_ns, ticking.take()) == (0, ["a"])
    ticking.after(1).add("b")
    assert (ticking.due_in_ns, ticking.take()) == (PATIENCE_NS, [])
    ticking.after(250 * US - 1).event()
    assert ticking.due_in_ns == 250 * US
    assert ticking.after(250 * US).take() == ["b"]


@pytest.mark.parametrize(
    ("takes_ns", "latest_ns"),
    # where it fits into the middle half; and in the second quarter of a gap where it is too long for any
    [(100 * US, 650 * US), (5 * MS, 500 * US)],
)
def test_a_task_begins_where_it_fits_into_a_gap(ticking: Loop, takes_ns: int, latest_ns: int) -> None:
    ticking.took("a", takes_ns)
    ticking.ticks(1)
    ticking.add("a")
    assert ticking.due_in_ns == 250 * US
    # a little too late
    assert ticking.after(latest_ns + 1).take() == []
    assert ticking.due_in_ns == PATIENCE_NS - latest_ns - 1
    ticking.after(MS - latest_ns - 1).event()
    assert ticking.after(latest_ns).take() == ["a"]


def test_the_time_that_a_task_takes_is_a_mean(ticking: Loop) -> None:
    ticking.took("a", 100 * US)
    ticking.took("a", 900 * US)
    # 200 us
    for begin_us, fits in ((550, True), (551, False)):
        ticking.ticks(1)
        ticking.after(begin_us * US).add("a")
        assert (ticking.take() == ["a"]) is fits
        ticking.after((1000 - begin_us) * US).event()


def test_each_gap_takes_one_task(ticking: Loop) -> None:
    ticking.add("a", "b")
    assert ticking.after(250 * US).take() == ["a"]
    ticking.after(10 * US).took("a", 10 * US)
    assert ticking.due_in_ns > 10 * MS
    ticking.after(740 * US).event()
    assert ticking.due_in_ns == 250 * US
    assert ticking.after(250 * US).take() == ["b"]


def test_tasks_that_are_not_needed_fill_a_gap_and_leave_others_the_processor_for_half_as_long(ticking: Loop) -> None:
    ticking.add("a", "b", "c")
    ticking.add("settle", within_ns=NEVER_NS)
    assert ticking.after(250 * US).take() == ["a"]
    ticking.after(100 * US).took("a", 100 * US)
    assert ticking.due_in_ns == 50 * US
    assert ticking.after(50 * US - 1).take() == []
    assert ticking.after(1).take() == ["settle"]
    ticking.after(40 * US).took("settle", 40 * US)
    ticking.add("settle", within_ns=NEVER_NS)
    assert ticking.due_in_ns == 20 * US
    assert ticking.after(20 * US).take() == ["settle"]
    ticking.after(540 * US).event()
    # before one that is needed such a task takes no place
    ticking.add("settle", within_ns=NEVER_NS)
    ticking.after(250 * US)
    assert (ticking.take(), ticking.take(), ticking.take()) == (["b"], ["settle"], [])


def test_a_task_that_is_not_needed_leaves_the_gap_to_one_that_is(ticking: Loop) -> None:
    ticking.add("settle", within_ns=NEVER_NS)
    ticking.add("a", "b")
    assert ticking.after(250 * US).take() == ["settle"]
    ticking.after(40 * US).took("settle", 40 * US)
    assert ticking.after(20 * US).take() == ["a"]
    # and that was the one of this gap
    assert ticking.after(20 * US).take() == []


def test_a_task_that_is_overdue_leaves_the_gap_to_the_next(ticking: Loop) -> None:
    ticking.add("a", within_ns=100 * US)
    ticking.add("b", "c")
    assert ticking.after(250 * US).take() == ["a"]
    assert ticking.take() == ["b"]
    assert ticking.take() == []


def test_a_task_that_is_not_needed_is_not_run_without_a_gap(loop: Loop) -> None:
    loop.event()
    loop.add("settle", within_ns=NEVER_NS)
    assert loop.due_in_ns == -1
    loop.tasks.forget_unneeded()
    # what is needed waits for as long as ever
    loop.add("a")
    assert loop.due_in_ns == PATIENCE_NS
    assert loop.after(PATIENCE_NS).take() == ["a"]


def test_a_task_is_over_before_the_deadline_of_the_node(ticking: Loop) -> None:
    ticking.took("a", 100 * US)
    ticking.ticks(1)
    deadline_ns = ticking.clock.monotonic_ns() + 350 * US
    ticking.add("a")
    assert ticking.after(250 * US + 1).take(deadline_ns) == []
    assert ticking.due_in_ns > 10 * MS
    ticking.after(750 * US - 1).event()
    assert ticking.after(250 * US).take(ticking.clock.monotonic_ns() + 100 * US) == ["a"]


def test_only_the_gap_after_the_last_event_of_a_tick_is_measured_and_idle(loop: Loop) -> None:
    for _ in range(20):
        loop.after(600 * US).event(is_last=False)
        loop.after(400 * US).event()
    loop.add("a")
    assert loop.due_in_ns == 150 * US
    loop.after(600 * US).event(is_last=False)
    assert loop.due_in_ns > 10 * MS
    loop.after(400 * US).event()
    assert loop.due_in_ns == 150 * US


def test_gaps_of_five_milliseconds_and_more_are_not_measured(ticking: Loop) -> None:
    ticking.after(5 * MS).event()
    ticking.add("a")
    assert ticking.due_in_ns == 250 * US
    other = Loop()
    other.ticks(8)
    other.after(5 * MS - 8).event()
    other.add("a")
    # by an eighth of the difference
    assert other.due_in_ns == (MS + (4 * MS - 8) // 8) // 4


def test_the_first_gap_is_believed_and_none_before_it(loop: Loop) -> None:
    loop.event()
    loop.add("a")
    assert loop.due_in_ns == PATIENCE_NS
    loop.after(2 * MS).event()
    assert loop.due_in_ns == 500 * US


def test_a_message_that_a_task_kept_waiting_ended_the_gap_where_the_task_began(ticking: Loop) -> None:
    ticking.add("a", "b")
    assert ticking.after(250 * US).take() == ["a"]
    ticking.after(150 * US).took("a", 150 * US, met=True)
    # nothing more in this gap
    assert ticking.due_in_ns > 10 * MS
    ticking.after(600 * US).event()
    # 0.25 ms instead of 1 ms was measured, an eighth of which counts
    assert ticking.due_in_ns == (MS - 750 * US // 8) // 4
    # once
    ticking.after(MS).event()
    assert ticking.due_in_ns > (MS - 750 * US // 8) // 4


def test_without_a_gap_a_task_waits_for_20_ms_or_as_long_as_is_said_and_not_longer(loop: Loop) -> None:
    loop.event(is_last=False)
    loop.add("a")
    loop.add("b", within_ns=3 * MS)
    loop.add("c")
    for _ in range(2):
        loop.after(MS).event(is_last=False)
        assert loop.take() == []
    loop.after(MS - 1)
    assert (loop.due_in_ns, loop.take()) == (1, [])
    # what was added before it keeps its place
    assert loop.after(1).take() == ["a", "b"]
    assert loop.due_in_ns == PATIENCE_NS - 3 * MS
    assert loop.after(PATIENCE_NS - 3 * MS).take() == ["c"]


def test_a_task_that_is_run_without_a_gap_does_not_begin_one(loop: Loop) -> None:
    for _ in range(20):
        loop.after(600 * US).event(is_last=False)
        loop.after(400 * US).event()
    loop.add("a", within_ns=700 * US)
    loop.add("b")
    loop.took("a", MS)
    # 0.1 ms after the other event the task is overdue
    loop.after(600 * US).event(is_last=False)
    assert loop.after(100 * US).take() == ["a"]
    loop.took("a", 10 * US)
    assert loop.due_in_ns == PATIENCE_NS - 700 * US


def test_the_turns_of_a_node_are_taken_in_their_order(ticking: Loop) -> None:
    ticking.add("a")
    assert not ticking.tasks.has_turns
    ticking.add("b", "c", is_turn=True)
    assert ticking.tasks.has_turns
    assert ticking.tasks.take_turn() == ticking.named("b")
    assert ticking.tasks.take_turn() == ticking.named("c")
    assert ticking.tasks.take_turn() is None
    assert not ticking.tasks.has_turns
    assert ticking.due_in_ns == 250 * US
    assert ticking.after(250 * US).take() == ["a"]
    ticking.add("b", is_turn=True)
    ticking.tasks.take_turn()
    assert ticking.due_in_ns == -1


def test_what_is_not_needed_can_be_forgotten_and_is_no_turn_to_wait_for(ticking: Loop) -> None:
    ticking.add("settle", is_turn=True, within_ns=NEVER_NS)
    ticking.add("a", is_turn=True)
    assert ticking.tasks.has_turns
    ticking.tasks.forget_unneeded()
    assert ticking.tasks.take_turn() == ticking.named("a")
    assert ticking.tasks.take_turn() is None
    ticking.add("settle", is_turn=True, within_ns=NEVER_NS)
    assert not ticking.tasks.has_turns
    assert ticking.tasks.take_turn() == ticking.named("settle")


def test_a_task_is_no_turn_and_waits_for_20_ms_unless_something_else_is_said(loop: Loop) -> None:
    loop.event(is_last=False)
    loop.tasks.add(loop.named("a"))
    assert not loop.tasks.has_turns
    assert loop.tasks.take_turn() is None
    assert loop.due_in_ns == PATIENCE_NS


def test_the_first_quarter_belongs_to_others_after_a_task_as_well(ticking: Loop) -> None:
    ticking.after(50 * US).took("a", 10 * US)
    ticking.add("b")
    assert ticking.due_in_ns == 200 * US


def test_a_gap_that_a_message_has_ended_takes_nothing_any_more(ticking: Loop) -> None:
    ticking.add("settle", within_ns=NEVER_NS)
    ticking.after(300 * US).took("a", 50 * US, met=True)
    assert (ticking.due_in_ns, ticking.after(100 * US).take()) == (-1, [])
    ticking.after(600 * US).event()
    assert ticking.due_in_ns > 0


@pytest.mark.parametrize(
    ("takes_us", "now_us", "next_us", "begins_us"),
    [
        # in the gap from 0 to 1000 us: the second and third quarters are free
        (100, 0, 5000, 250),
        (100, 249, 5000, 250),
        (100, 600, 5000, 600),
        (100, 650, 5000, 650),
        (100, 651, 5000, None),
        (0, 750, 5000, 750),
        (0, 751, 5000, None),
        # a long one begins in the second quarter
        (900, 0, 5000, 250),
        (900, 500, 5000, 500),
        (900, 501, 5000, None),
        # before the deadline of the node in any case
        (100, 0, 350, 250),
        (100, 0, 349, None),
        (900, 0, 1149, None),
    ],
)
def test_a_task_fits_into_the_middle_half_of_a_gap(
    takes_us: int, now_us: int, next_us: int, begins_us: int | None
) -> None:
    begin_ns = 7 * MS
    gap = gap_after(begin_ns, MS)
    expected_ns = NEVER_NS if begins_us is None else begin_ns + begins_us * US
    assert gap.fits_from(takes_us * US, begin_ns + now_us * US, begin_ns + next_us * US) == expected_ns


def test_nothing_fits_into_a_gap_of_unknown_length_or_one_that_is_over() -> None:
    assert gap_after(7 * MS, 0).fits_from(0, 7 * MS, NEVER_NS) == NEVER_NS
    assert gap_after(7 * MS, MS)._replace(free_ns=NEVER_NS).fits_from(0, 7 * MS, NEVER_NS) == NEVER_NS

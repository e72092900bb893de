"""Deferred work at its bounds: when a loop counts as running, when a pause is over, and work that does not wait."""

from services.runtime.loop.clock import NEVER_NS
from services.runtime.loop.quiet_work import QuietWork

MS = 1_000_000
PAUSE_NS = 200_000


def ticking(at_ns: int = 10 * MS) -> QuietWork:
    work = QuietWork(PAUSE_NS)
    work.note_tick(at_ns)
    return work


def test_a_loop_runs_for_five_milliseconds_after_its_last_tick() -> None:
    work = ticking()
    work.add(15 * MS - 1, "a")
    assert work.due_ns == 35 * MS - 1
    work = ticking()
    work.add(15 * MS, "a")
    assert (work.due_ns, work.take(15 * MS)) == (15 * MS, ["a"])


def test_a_pause_that_has_begun_is_too_late_for_what_comes_then() -> None:
    for late_ns, due_ns in ((-1, 10 * MS + PAUSE_NS), (0, 30 * MS + PAUSE_NS), (1, 30 * MS + PAUSE_NS + 1)):
        work = ticking()
        work.add(10 * MS + PAUSE_NS + late_ns, "a")
        assert work.due_ns == due_ns


def test_work_that_does_not_wait_for_pauses_is_due_when_it_comes_and_all_of_it() -> None:
    work = ticking()
    work.do_at_once()
    work.add(10 * MS + 1, "a", "b")
    assert (work.due_ns, work.take(10 * MS + 1)) == (10 * MS + 1, ["a", "b"])
    assert work.due_ns == NEVER_NS


def test_what_is_left_after_a_pause_is_due_at_the_end_of_its_patience_though_no_tick_comes() -> None:
    work = ticking()
    work.add(10 * MS, "a", "b", "c")
    assert work.take(10 * MS + PAUSE_NS) == ["a"]
    assert work.due_ns == 30 * MS
    assert work.take(30 * MS - 1) == []
    assert work.take(30 * MS) == ["b", "c"]


def test_a_tick_near_the_end_of_the_patience_does_not_put_the_work_off_beyond_it() -> None:
    work = ticking()
    work.add(10 * MS + 50_000, "a")
    work.note_tick(30 * MS)
    assert work.due_ns == 30 * MS + 50_000
    # and one without work makes nothing due
    idle = ticking()
    idle.note_tick(11 * MS)
    assert idle.due_ns == NEVER_NS
    assert idle.take(12 * MS) == []

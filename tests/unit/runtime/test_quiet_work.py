from services.runtime.loop.clock import NEVER_NS
from services.runtime.loop.quiet_work import QuietWork

MS = 1_000_000
PAUSE_NS = 200_000


def ticking() -> QuietWork:
    work = QuietWork(PAUSE_NS)
    work.note_tick(10 * MS)
    return work


def test_without_ticks_everything_is_due_at_once_in_its_order() -> None:
    work = QuietWork(PAUSE_NS)
    assert work.due_ns == NEVER_NS
    work.add(5 * MS, "a", "b")
    work.add(5 * MS, "b", "c")
    assert work.due_ns == 5 * MS
    assert work.take(5 * MS) == ["a", "b", "c"]
    assert (work.due_ns, work.take(6 * MS)) == (NEVER_NS, [])


def test_in_a_loop_each_pause_takes_one_piece() -> None:
    work = ticking()
    work.add(10 * MS + 100_000, "a", "b")
    assert work.due_ns == 10 * MS + PAUSE_NS
    assert work.take(10 * MS + PAUSE_NS - 1) == []
    assert work.take(10 * MS + PAUSE_NS) == ["a"]
    # the pause is over with it
    assert work.take(10 * MS + PAUSE_NS + 50_000) == []
    work.note_tick(11 * MS)
    assert work.due_ns == 11 * MS + PAUSE_NS
    assert work.take(11 * MS + PAUSE_NS) == ["b"]
    assert work.due_ns == NEVER_NS


def test_what_comes_after_the_pause_has_begun_waits_for_the_next_one() -> None:
    work = ticking()
    work.add(10 * MS + 300_000, "a")
    assert work.take(10 * MS + 900_000) == []
    work.note_tick(11 * MS)
    assert work.take(11 * MS + PAUSE_NS) == ["a"]


def test_pieces_that_are_added_while_others_wait_come_after_them_and_none_twice() -> None:
    work = ticking()
    work.add(10 * MS, "a", "b")
    work.add(10 * MS + 50_000, "b", "c")
    taken = []
    for tick in range(10, 14):
        work.note_tick(tick * MS)
        taken += work.take(tick * MS + PAUSE_NS)
    assert taken == ["a", "b", "c"]


def test_where_the_ticks_end_all_pieces_are_due_after_20_ms_and_not_before() -> None:
    work = ticking()
    work.add(10 * MS + 300_000, "a", "b")
    assert work.due_ns == 30 * MS + 300_000
    assert work.take(30 * MS + 299_999) == []
    assert work.take(30 * MS + 300_000) == ["a", "b"]


def test_ticks_without_a_pause_keep_nothing_back_for_longer_than_that() -> None:
    # each tick comes before the pause of the last one
    work = ticking()
    work.add(10 * MS, "a", "b")
    taken: list[str] = []
    for now_ns in range(10 * MS, 30 * MS, 100_000):
        work.note_tick(now_ns)
        taken += work.take(now_ns)
    assert taken == []
    work.note_tick(30 * MS)
    assert work.take(30 * MS) == ["a", "b"]

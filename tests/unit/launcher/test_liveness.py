import pytest

from services.launcher.liveness import NODE_SILENT_S, SITE_SILENT_S, Change, Watch
from services.runtime.clock import VirtualClock

SECOND_NS = 1_000_000_000
NODES = ("afm_node@slave", "controller@slave")
EPOCH_NS = 10**18


def watched(site: str = "") -> tuple[VirtualClock, Watch]:
    clock = VirtualClock(start_ns=SECOND_NS, epoch_offset_ns=EPOCH_NS)
    return clock, Watch(clock, NODES, site)


def pass_s(clock: VirtualClock, duration_s: float) -> None:
    clock.advance_ns(round(duration_s * SECOND_NS))


def told(changes: list[Change]) -> list[tuple[str, bool]]:
    return [(change.who, change.silent) for change in changes]


def test_who_was_never_heard_is_not_told_as_silent() -> None:
    clock, watch = watched()
    pass_s(clock, 100.0)
    assert watch.look() == []
    assert not watch.heard


def test_a_node_is_told_as_silent_after_its_limit_and_once() -> None:
    clock, watch = watched()
    for node in NODES:
        watch.enter(node)
    pass_s(clock, NODE_SILENT_S)
    watch.enter(NODES[0])
    assert watch.look() == []
    pass_s(clock, 0.001)
    (change,) = watch.look()
    assert (change.who, change.nodes, change.silent) == (NODES[1], (NODES[1],), True)
    assert change.since_ns == SECOND_NS + EPOCH_NS
    assert change.silence_s == pytest.approx(NODE_SILENT_S + 0.001, rel=1e-9)
    assert watch.look() == []
    assert watch.silent == [NODES[1]]
    assert watch.heard


def test_a_return_says_how_long_it_was() -> None:
    clock, watch = watched()
    watch.enter(NODES[0])
    pass_s(clock, 60.0)
    assert told(watch.look()) == [(NODES[0], True)]
    watch.enter(NODES[0])
    (change,) = watch.look()
    assert (change.who, change.silent, change.first) == (NODES[0], False, False)
    assert change.silence_s == pytest.approx(60.0, rel=1e-9)
    assert change.since_ns == SECOND_NS + EPOCH_NS
    assert watch.silent == []


def test_strangers_are_not_watched() -> None:
    clock, watch = watched("slave")
    watch.enter("recorder@slave")
    assert watch.look() == []
    pass_s(clock, 10.0)
    assert watch.look() == []


def test_a_cable_is_told_as_a_site_and_not_as_its_nodes() -> None:
    clock, watch = watched("slave")
    watch.enter(NODES[0])
    (first,) = watch.look()
    assert (first.who, first.silent, first.first) == ("the slave's site", False, True)
    # reports of the two come half a period apart
    pass_s(clock, 0.25)
    watch.enter(NODES[1])
    pass_s(clock, SITE_SILENT_S + 0.001)
    assert told(watch.look()) == [("the slave's site", True)]
    pass_s(clock, 60.0)
    assert watch.look() == []
    assert not watch.heard
    watch.enter(NODES[1])
    (back,) = watch.look()
    assert (back.who, back.nodes, back.silent) == ("the slave's site", NODES, False)
    assert back.silence_s == pytest.approx(62.001, rel=1e-9)
    # the other node has its time to start, and is then silent for as long as it really was
    for _ in range(39):
        pass_s(clock, 0.5)
        watch.enter(NODES[1])
        assert watch.look() == []
    pass_s(clock, 0.5)
    (late,) = watch.look()
    assert (late.who, late.silent, late.since_ns) == (NODES[0], True, SECOND_NS + EPOCH_NS)


def test_a_node_that_came_back_with_its_site_is_watched_as_before() -> None:
    clock, watch = watched("slave")
    for node in NODES:
        watch.enter(node)
    watch.look()
    pass_s(clock, 5.0)
    watch.look()
    for node in NODES:
        watch.enter(node)
    assert told(watch.look()) == [("the slave's site", False)]
    for _ in range(7):
        pass_s(clock, 0.5)
        watch.enter(NODES[1])
    assert told(watch.look()) == [(NODES[0], True)]


def test_a_node_that_was_silent_before_is_part_of_the_site() -> None:
    clock, watch = watched("slave")
    for node in NODES:
        watch.enter(node)
    watch.look()
    for _ in range(8):
        pass_s(clock, 0.5)
        watch.enter(NODES[1])
        changes = watch.look()
        if changes:
            assert told(changes) == [(NODES[0], True)]
    assert watch.silent == [NODES[0]]
    pass_s(clock, 3.0)
    assert told(watch.look()) == [("the slave's site", True)]
    assert watch.silent == ["the slave's site"]
    watch.enter(NODES[0])
    assert told(watch.look()) == [("the slave's site", False)]
    assert watch.silent == []

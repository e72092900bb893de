import pytest

from telenano.launcher.liveness import NODE_TIMEOUT_S, SITE_TIMEOUT_S, Change, LivenessMonitor
from telenano.testing import VirtualClock

SECOND_NS = 1_000_000_000
NODES = ("afm_node@slave", "controller@slave")
EPOCH_NS = 10**18


def monitored(site: str = "") -> tuple[VirtualClock, LivenessMonitor]:
    clock = VirtualClock(start_ns=SECOND_NS, epoch_offset_ns=EPOCH_NS)
    return clock, LivenessMonitor(clock, NODES, site)


def pass_s(clock: VirtualClock, duration_s: float) -> None:
    clock.advance_ns(round(duration_s * SECOND_NS))


def reported(changes: list[Change]) -> list[tuple[str, bool]]:
    return [(change.subject, change.silent) for change in changes]


def test_a_node_that_never_reported_is_not_reported_as_silent() -> None:
    clock, monitor = monitored()
    pass_s(clock, 100.0)
    assert monitor.check() == []
    assert not monitor.any_alive


def test_a_node_is_reported_as_silent_once_after_its_timeout() -> None:
    clock, monitor = monitored()
    for node in NODES:
        monitor.record(node)
    pass_s(clock, NODE_TIMEOUT_S)
    monitor.record(NODES[0])
    assert monitor.check() == []
    pass_s(clock, 0.001)
    (change,) = monitor.check()
    assert (change.subject, change.nodes, change.silent) == (NODES[1], (NODES[1],), True)
    assert change.since_ns == SECOND_NS + EPOCH_NS
    assert change.silence_s == pytest.approx(NODE_TIMEOUT_S + 0.001, rel=1e-9)
    assert monitor.check() == []
    assert monitor.silent == [NODES[1]]
    assert monitor.any_alive


def test_a_return_says_how_long_it_was() -> None:
    clock, monitor = monitored()
    monitor.record(NODES[0])
    pass_s(clock, 60.0)
    assert reported(monitor.check()) == [(NODES[0], True)]
    monitor.record(NODES[0])
    (change,) = monitor.check()
    assert (change.subject, change.silent, change.first) == (NODES[0], False, False)
    assert change.silence_s == pytest.approx(60.0, rel=1e-9)
    assert change.since_ns == SECOND_NS + EPOCH_NS
    assert monitor.silent == []


def test_other_nodes_are_not_monitored() -> None:
    clock, monitor = monitored("slave")
    monitor.record("recorder@slave")
    assert monitor.check() == []
    pass_s(clock, 10.0)
    assert monitor.check() == []


def test_a_pulled_cable_is_reported_as_a_site_and_not_as_its_nodes() -> None:
    clock, monitor = monitored("slave")
    monitor.record(NODES[0])
    (first,) = monitor.check()
    assert (first.subject, first.silent, first.first) == ("the slave's site", False, True)
    # reports of the two come half a period apart
    pass_s(clock, 0.25)
    monitor.record(NODES[1])
    pass_s(clock, SITE_TIMEOUT_S + 0.001)
    assert reported(monitor.check()) == [("the slave's site", True)]
    pass_s(clock, 60.0)
    assert monitor.check() == []
    assert not monitor.any_alive
    monitor.record(NODES[1])
    (back,) = monitor.check()
    assert (back.subject, back.nodes, back.silent) == ("the slave's site", NODES, False)
    assert back.silence_s == pytest.approx(62.001, rel=1e-9)
    # the other node has its time to start, and is then silent for as long as it really was
    for _ in range(39):
        pass_s(clock, 0.5)
        monitor.record(NODES[1])
        assert monitor.check() == []
    pass_s(clock, 0.5)
    (late,) = monitor.check()
    assert (late.subject, late.silent, late.since_ns) == (NODES[0], True, SECOND_NS + EPOCH_NS)


def test_a_node_that_came_back_with_its_site_is_monitored_as_before() -> None:
    clock, monitor = monitored("slave")
    for node in NODES:
        monitor.record(node)
    monitor.check()
    pass_s(clock, 5.0)
    monitor.check()
    for node in NODES:
        monitor.record(node)
    assert reported(monitor.check()) == [("the slave's site", False)]
    for _ in range(7):
        pass_s(clock, 0.5)
        monitor.record(NODES[1])
    assert reported(monitor.check()) == [(NODES[0], True)]


def test_a_node_that_was_silent_before_is_part_of_the_site() -> None:
    clock, monitor = monitored("slave")
    for node in NODES:
        monitor.record(node)
    monitor.check()
    for _ in range(8):
        pass_s(clock, 0.5)
        monitor.record(NODES[1])
        changes = monitor.check()
        if changes:
            assert reported(changes) == [(NODES[0], True)]
    assert monitor.silent == [NODES[0]]
    pass_s(clock, 3.0)
    assert reported(monitor.check()) == [("the slave's site", True)]
    assert monitor.silent == ["the slave's site"]
    monitor.record(NODES[0])
    assert reported(monitor.check()) == [("the slave's site", False)]
    assert monitor.silent == []

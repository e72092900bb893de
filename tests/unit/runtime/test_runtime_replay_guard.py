"""What comes from a recording stays away from devices, and is not taken for a repetition by readers."""

from typing import Any

import pytest

from proto.messages import SessionEvent
from proto.sequence import Arrival, SequenceTracker
from services.runtime.loop.replay_guard import ReplayGuard

SECOND_NS = 1_000_000_000
HEALTH = {
    "pid": 1,
    "state": "running",
    "uptime_s": 1.0,
    "rate_hz": 1000.0,
    "period_s": 0.0,
    "lateness_p50_s": 0.0,
    "lateness_p99_s": 0.0,
    "lateness_max_s": 0.0,
    "overruns": 0,
    "rejected": {},
    "cpu_percent": 0.0,
    "memory_bytes": 0,
    "realtime": False,
    "memory_locked": False,
    "inputs": (),
}
COMMAND = {"mode": "hold", "base_position_m": (0.0, 0.0, 0.0), "hand_seq": 0, "hand_t_ns": 0}
SOURCE = "controller@slave"


@pytest.fixture
def bench(bench_of: Any) -> Any:
    return bench_of("afm_node@slave")


def command(bench: Any) -> Any:
    return bench.received("afm/command", SOURCE, **COMMAND)


def control(bench: Any, name: str, src: str = "launcher@master") -> Any:
    return bench.received("session/control", src, id="1", command=name, target="*", parameters={})


def test_commands_of_a_source_marked_replay_are_refused_until_it_is_live_again(bench: Any) -> None:
    guard = ReplayGuard(bench.context, allow=False)
    assert guard.admits(command(bench))
    assert guard.admits(bench.received("node/health", SOURCE, replay=True, **HEALTH))
    assert not guard.admits(command(bench))
    assert not guard.admits(command(bench))
    assert guard.admits(bench.received("afm/command", "controller@master", **COMMAND))
    guard.admits(bench.received("node/health", SOURCE, replay=False, **HEALTH))
    assert guard.admits(command(bench))


def test_the_refusal_is_reported_once(bench: Any) -> None:
    guard = ReplayGuard(bench.context, allow=False)
    guard.admits(bench.received("node/health", SOURCE, replay=True, **HEALTH))
    for _ in range(5):
        guard.admits(command(bench))
    (event,) = bench.take("session/event")
    assert isinstance(event, SessionEvent)
    assert (event.kind, event.level, event.data["source"]) == ("fault", "warning", SOURCE)


def test_replayed_commands_are_obeyed_where_that_is_allowed(bench: Any) -> None:
    guard = ReplayGuard(bench.context, allow=True)
    guard.admits(bench.received("node/health", SOURCE, replay=True, **HEALTH))
    assert guard.admits(command(bench))


def test_a_replayed_session_arms_nothing_but_may_stop_everything(bench: Any) -> None:
    guard = ReplayGuard(bench.context, allow=False)
    guard.admits(bench.received("node/health", "launcher@master", replay=True, **HEALTH))
    assert not guard.admits(control(bench, "arm"))
    assert guard.admits(control(bench, "estop"))


def filled(count: int, t_ns: int = 100 * SECOND_NS) -> SequenceTracker:
    tracker = SequenceTracker()
    for seq in range(count):
        tracker.accept(seq, t_ns + seq)
    return tracker


def test_a_recording_played_after_its_publisher_was_received_is_a_restart() -> None:
    tracker = filled(5000)
    arrivals = [tracker.accept(seq, 5 * SECOND_NS + seq) for seq in range(100)]
    assert arrivals[:7] == [Arrival.DUPLICATE] * 7
    assert arrivals[7] is Arrival.RESTART
    assert set(arrivals[8:]) == {Arrival.NEXT}
    assert (tracker.restarts, tracker.lost) == (1, 0)


def test_repetitions_between_fresh_messages_or_young_ones_are_no_restart() -> None:
    tracker = filled(100)
    for seq in range(100, 200):
        assert tracker.accept(seq, 100 * SECOND_NS + seq) is Arrival.NEXT
        assert tracker.accept(seq, 100 * SECOND_NS + seq) is Arrival.DUPLICATE
        assert tracker.accept(seq - 100, 5 * SECOND_NS) is Arrival.DUPLICATE
    for seq in range(150, 200):
        assert tracker.accept(seq, 100 * SECOND_NS + seq) is Arrival.DUPLICATE
    assert tracker.restarts == 0

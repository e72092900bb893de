"""A reader finds a longer way from arrivals: soon after a jump, and never from a queue, a stall or a gap."""

import random

import pytest

from telenano.timing.longer_way import MOST_NS, LongerWay

MS = 1_000_000


def heard(ways_ms: list[float], period_ms: float = 1.0, between: int = 2) -> list[tuple[float, int]]:
    """Let messages arrive, in order, after these delays; return the time of arrival [ms] and what is found [ns]."""
    reader, seen, newest = LongerWay(between=between), list[tuple[float, int]](), -1
    arrivals = sorted(
        (round((at * period_ms + way) * MS), round(at * period_ms * MS)) for at, way in enumerate(ways_ms)
    )
    for received_ns, stamp_ns in arrivals:
        if stamp_ns < newest:
            continue
        newest = stamp_ns
        reader.arrived(stamp_ns, received_ns, 0, 0)
        reader.ends(received_ns)
        seen.append((received_ns / MS, reader.more_ns))
    return seen


def stepped(rng: random.Random, before_ms: float, after_ms: float, jitter_ms: float) -> list[float]:
    ways = [before_ms + rng.uniform(0.0, jitter_ms) for _ in range(600)]
    return ways + [after_ms + rng.uniform(0.0, jitter_ms) for _ in range(600)]


@pytest.mark.parametrize("seed", range(12))
def test_a_drawn_step_is_found_within_a_tenth_of_a_second_of_its_first_message(seed: int) -> None:
    rng = random.Random(seed)
    before_ms, jitter_ms = rng.uniform(1.0, 60.0), rng.uniform(0.0, 1.0)
    after_ms = before_ms + rng.uniform(20.0, 150.0)
    found = [at for at, more_ns in heard(stepped(rng, before_ms, after_ms, jitter_ms)) if more_ns]
    assert 600.0 + after_ms + 40.0 <= found[0] <= 600.0 + after_ms + 100.0
    more_ms = next(more_ns for _, more_ns in heard(stepped(rng, before_ms, after_ms, jitter_ms)) if more_ns) / MS
    assert more_ms == pytest.approx(after_ms - before_ms, abs=2.0 * jitter_ms + 0.1)


def test_a_round_trip_whose_ways_become_longer_one_after_the_other_is_found() -> None:
    ways = [40.0] * 600 + [100.0] * 20 + [160.0] * 600
    found = [(at, more_ns) for at, more_ns in heard(ways, between=16) if more_ns]
    assert found[0][0] <= 620.0 + 160.0 + 60.0
    assert found[0][1] == 120 * MS


@pytest.mark.parametrize("seed", range(12))
def test_a_queue_that_fills_and_drains_is_no_longer_way(seed: int) -> None:
    rng = random.Random(seed)
    depth_ms, half = rng.uniform(20.0, 150.0), rng.randrange(100, 500)
    rise = [5.0 + depth_ms * n / half for n in range(half)]
    assert not any(more_ns for _, more_ns in heard([5.0] * 600 + rise + rise[::-1] + [5.0] * 100))


@pytest.mark.parametrize("held_ms", [30, 60, 200])
def test_messages_that_were_held_up_and_come_together_are_none(held_ms: int) -> None:
    held = [5.0 + held_ms - n for n in range(held_ms)]
    assert not any(more_ns for _, more_ns in heard([5.0] * 600 + held + [5.0] * 300))


def test_what_no_link_reports_ends_after_a_second_and_is_bounded() -> None:
    seen = heard([5.0] * 600 + [905.0] * 2500)
    assert max(more_ns for _, more_ns in seen) == MOST_NS
    first = next(at for at, more_ns in seen if more_ns)
    last = max(at for at, more_ns in seen if more_ns)
    assert last - first <= 1001.0


def test_what_the_link_reports_is_not_counted_twice() -> None:
    reader = LongerWay()
    for at in range(1400):
        reported_ns = 80 * MS if at > 1200 else 20 * MS
        if at == 1200:
            assert reader.more_ns == 60 * MS
            reader.reported(60 * MS)
            assert reader.more_ns == 0
        way_ms = 20 if at < 600 else 80
        reader.arrived(at * MS, (at + way_ms) * MS, 0, reported_ns)
    assert reader.more_ns == 0


def test_a_way_that_the_link_reports_late_after_it_was_shorter_is_not_longer() -> None:
    reader = LongerWay()
    for at in range(2000):
        way_ms, reported_ms = (120 if at < 600 else 60), (120 if at < 900 else 60)
        reader.arrived(at * MS, (at + way_ms) * MS, 0, reported_ms * MS)
        assert reader.more_ns == 0


def test_a_way_that_is_short_again_is_known_by_its_first_message() -> None:
    reader = LongerWay()
    for at in range(1000):
        way_ms = 80 if 600 <= at < 800 else 20
        reader.arrived(at * MS, (at + way_ms) * MS, 0, 20 * MS)
        assert reader.more_ns == (60 * MS if 640 <= at < 800 else 0) or 600 <= at < 680

"""Four time stamps: exact on a symmetric path, off by half the asymmetry, never by more than half the round trip."""

import random

import pytest

from services.runtime.loop.clock_offset import Exchange, OffsetFilter


def exchange(offset_ns: int, there_ns: int, back_ns: int, sent_ns: int = 10**18, spent_ns: int = 5_000) -> Exchange:
    received = sent_ns + there_ns + offset_ns
    return Exchange(sent_ns, received, received + spent_ns, sent_ns + there_ns + spent_ns + back_ns)


@pytest.mark.parametrize("offset_ns", [0, 1, -3_000_000_000, 7 * 10**15])
def test_symmetric_path_gives_the_injected_offset(offset_ns: int) -> None:
    measured = exchange(offset_ns, 80_000, 80_000)
    assert measured.offset_ns == offset_ns
    assert measured.round_trip_ns == 160_000


@pytest.mark.parametrize(("there_ns", "back_ns"), [(30_000_000, 10_000_000), (0, 50_000_000), (50_000_000, 0)])
def test_asymmetric_path_shifts_the_estimate_by_half_of_the_asymmetry(there_ns: int, back_ns: int) -> None:
    offsets = OffsetFilter(8)
    offsets.record(exchange(500_000_000, there_ns, back_ns))
    estimate = offsets.estimate()
    assert estimate is not None
    error_s = estimate.offset_s - 0.5
    assert error_s == pytest.approx(0.5e-9 * (there_ns - back_ns), rel=1e-9, abs=0.0)
    assert abs(error_s) <= estimate.uncertainty_s * (1 + 1e-9)


def test_uncertainty_is_reached_when_one_way_takes_no_time_and_never_passed() -> None:
    draw = random.Random(5)
    for _ in range(500):
        there, back = draw.randrange(10**8), draw.randrange(10**8)
        offsets = OffsetFilter(1)
        offsets.record(exchange(123_456_789, there, back))
        estimate = offsets.estimate()
        assert estimate is not None
        assert abs(estimate.offset_s - 0.123456789) <= estimate.uncertainty_s + 1e-12


def test_minimum_filter_believes_the_shortest_round_trip_in_view() -> None:
    offsets = OffsetFilter(3)
    offsets.record(exchange(1_000_000, 50_000, 50_000))
    for extra in (9_000_000, 5_000_000):
        offsets.record(exchange(1_000_000, 50_000 + extra, 50_000))
    best = offsets.estimate()
    assert best is not None
    assert (best.offset_s, best.exchanges) == (pytest.approx(1e-3, rel=1e-9, abs=0.0), 3)
    offsets.record(exchange(1_000_000, 7_050_000, 50_000))
    # the good one has left the window
    later = offsets.estimate()
    assert later is not None
    assert later.round_trip_s == pytest.approx(5.1e-3, rel=1e-9, abs=0.0)


def test_impossible_exchange_is_left_out() -> None:
    offsets = OffsetFilter(3)
    offsets.record(Exchange(100, 0, 500, 150))
    assert offsets.estimate() is None


@pytest.mark.parametrize("step_ns", [3_600 * 10**9, -3_600 * 10**9, 50_000_000])
def test_another_clock_is_known_at_its_first_exchange_and_not_after_a_window(step_ns: int) -> None:
    found = OffsetFilter(64)
    for turn in range(100):
        found.record(exchange(0, 2_000_000, 2_000_000, turn * 10**8))
    # the other site was started anew after its wall clock was set; its network is slower than it was
    found.record(exchange(step_ns, 9_000_000, 9_000_000, 10**10))
    estimate = found.estimate()
    assert estimate is not None
    assert estimate.offset_s == pytest.approx(step_ns * 1e-9, abs=1e-9)
    assert estimate.exchanges == 1


def test_a_slow_network_is_no_other_clock() -> None:
    found = OffsetFilter(64)
    for turn, (there_ns, back_ns) in enumerate(
        [(2_000_000, 2_000_000), (900_000_000, 1_000), (1_000, 900_000_000)] * 5
    ):
        found.record(exchange(0, there_ns, back_ns, turn * 10**8))
    estimate = found.estimate()
    assert estimate is not None
    assert estimate.exchanges == 15
    assert abs(estimate.offset_s) <= estimate.uncertainty_s


def test_window_holds_at_least_one() -> None:
    with pytest.raises(ValueError, match="window is 0"):
        OffsetFilter(0)

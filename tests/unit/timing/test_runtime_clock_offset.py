"""Four time stamps: exact on a symmetric path, off by half the asymmetry, never by more than half the round trip."""

import random
from collections.abc import Callable

import msgspec
import pytest

from telenano.timing.clock_offset import OffsetFilter, OffsetState


def exchange(offset_ns: int, there_ns: int, back_ns: int, sent_ns: int = 10**18, spent_ns: int = 5_000) -> list[int]:
    received = sent_ns + there_ns + offset_ns
    return [sent_ns, received, received + spent_ns, sent_ns + there_ns + spent_ns + back_ns]


@pytest.mark.parametrize("offset_ns", [0, 1, -3_000_000_000, 7 * 10**15])
def test_symmetric_path_gives_the_injected_offset(offset_ns: int) -> None:
    offsets = OffsetFilter(8)
    offsets.record(*exchange(offset_ns, 80_000, 80_000))
    estimate = offsets.estimate()
    assert estimate is not None
    assert estimate.offset_s == pytest.approx(offset_ns * 1e-9, rel=1e-12, abs=1e-12)
    assert estimate.round_trip_s == pytest.approx(160e-6, rel=1e-9, abs=0.0)


@pytest.mark.parametrize(("there_ns", "back_ns"), [(30_000_000, 10_000_000), (0, 50_000_000), (50_000_000, 0)])
def test_asymmetric_path_shifts_the_estimate_by_half_of_the_asymmetry(there_ns: int, back_ns: int) -> None:
    offsets = OffsetFilter(8)
    offsets.record(*exchange(500_000_000, there_ns, back_ns))
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
        offsets.record(*exchange(123_456_789, there, back))
        estimate = offsets.estimate()
        assert estimate is not None
        assert abs(estimate.offset_s - 0.123456789) <= estimate.uncertainty_s + 1e-12


def test_the_fastest_question_and_the_fastest_answer_in_view_count() -> None:
    offsets = OffsetFilter(3)
    for second, (there_ns, back_ns) in enumerate([(50_000, 9_000_000), (9_000_000, 50_000), (5_000_000, 5_000_000)]):
        offsets.record(*exchange(1_000_000, there_ns, back_ns, second * 10**9))
    best = offsets.estimate()
    assert best is not None
    assert best == (pytest.approx(1e-3, rel=1e-9), pytest.approx(5e-5), pytest.approx(1e-4), 3)
    for second in range(3, 12):
        offsets.record(*exchange(1_000_000, 5_000_000, 5_000_000, second * 10**9))
    # What an exchange a second takes at least now is known after as many of them as tell jitter from a longer route.
    later = offsets.estimate()
    assert later is not None
    assert later.round_trip_s == pytest.approx(1e-2, rel=1e-9, abs=0.0)


def test_impossible_exchange_is_left_out() -> None:
    offsets = OffsetFilter(3)
    offsets.record(100, 0, 500, 150)
    assert offsets.estimate() is None


@pytest.mark.parametrize("step_ns", [3_600 * 10**9, -3_600 * 10**9, 50_000_000])
def test_another_clock_is_known_at_its_first_exchange_and_not_after_a_window(step_ns: int) -> None:
    found = OffsetFilter(64)
    for turn in range(100):
        found.record(*exchange(0, 2_000_000, 2_000_000, turn * 10**8))
    # the other site was started anew after its wall clock was set; its network is slower than it was
    found.record(*exchange(step_ns, 9_000_000, 9_000_000, 10**10))
    estimate = found.estimate()
    assert estimate is not None
    assert estimate.offset_s == pytest.approx(step_ns * 1e-9, abs=1e-9)
    assert estimate.exchanges == 1


def test_a_slow_network_is_no_other_clock() -> None:
    found = OffsetFilter(64)
    for turn, (there_ns, back_ns) in enumerate(
        [(2_000_000, 2_000_000), (900_000_000, 1_000), (1_000, 900_000_000)] * 5
    ):
        found.record(*exchange(0, there_ns, back_ns, turn * 10**8))
    estimate = found.estimate()
    assert estimate is not None
    assert estimate.exchanges == 15
    assert abs(estimate.offset_s) <= estimate.uncertainty_s


def test_window_holds_at_least_one() -> None:
    with pytest.raises(ValueError, match="window is 0"):
        OffsetFilter(0)


def worst_error_s(course: Callable[[float], float], jitter_ms: tuple[float, float], base_ns: int = 20_000_000) -> float:
    """Give the largest error of the live estimate in ten minutes, from the third second on [s]."""
    draw, found, worst_s = random.Random(1), OffsetFilter(64), 0.0
    for asked_ns in range(0, 600 * 10**9, 10**8):
        there_ns, back_ns = (base_ns + round(draw.expovariate(1.0 / jitter) * 1e6) for jitter in jitter_ms)
        arrived_ns = asked_ns + there_ns
        stamps = (arrived_ns + round(course(arrived_ns * 1e-9) * 1e9) + late_ns for late_ns in (0, 100_000))
        found.record(asked_ns, *stamps, arrived_ns + 100_000 + back_ns)
        if asked_ns % 10**9 == 0 and asked_ns > 3 * 10**9:
            estimate = found.estimate()
            assert estimate is not None
            worst_s = max(worst_s, abs(estimate.offset_s - course((arrived_ns + back_ns) * 1e-9)))
    return worst_s


@pytest.mark.check("takes 0.9 s")
@pytest.mark.drawn(0.4, "telenano/timing/")
@pytest.mark.parametrize("drift", [5e-4, -5e-4, 2e-5, 0.0])
@pytest.mark.parametrize("jitter_ms", [(5.0, 0.2), (0.2, 5.0), (0.05, 0.05)])
def test_offset_is_kept_over_a_drift_and_asymmetric_jitter(drift: float, jitter_ms: tuple[float, float]) -> None:
    assert worst_error_s(lambda time_s: 5.0 + drift * time_s, jitter_ms) < 1e-3
    # ways of a fiftieth of a millisecond, as in one building
    assert worst_error_s(lambda time_s: drift * time_s, (0.05, 0.05), 20_000) < 3e-4


@pytest.mark.parametrize("stepped", [200, 203])
def test_a_step_that_the_round_trip_hides_is_found_within_seconds(stepped: int) -> None:
    found, errors_s = OffsetFilter(64), []
    for turn in range(400):
        ahead_ns = 0 if turn < stepped else 15_000_000
        found.record(*exchange(ahead_ns, 20_000_000, 20_000_000, turn * 10**8))
        estimate = found.estimate()
        assert estimate is not None
        errors_s.append(abs(estimate.offset_s - ahead_ns * 1e-9))
    assert max(errors_s[:200]) < 1e-9
    assert max(errors_s[270:]) < 1e-9


def test_a_state_goes_on_with_the_same_bits() -> None:
    draw, whole = random.Random(4), OffsetFilter(16)
    rest = None
    for turn in range(500):
        made = exchange(turn * 40_000, draw.randrange(10**7), draw.randrange(10**7), turn * 10**8)
        whole.record(*made)
        if rest is not None:
            rest.record(*made)
            assert rest.estimate() == whole.estimate()
        elif turn == 237:
            rest = OffsetFilter(16)
            rest.restore(msgspec.msgpack.decode(msgspec.msgpack.encode(whole.state), type=OffsetState))


@pytest.mark.parametrize("step_ns", [3_000_000, -30_000_000, 10**12])
def test_a_clock_that_was_set_is_told_of_once_with_what_it_was_and_is(step_ns: int) -> None:
    draw, offsets, told = random.Random(3), OffsetFilter(64), []
    for tick in range(600):
        offset_ns = 10**9 + (step_ns if tick >= 300 else 0)
        ways = (1_000_000 + draw.randrange(200_000) for _ in range(2))
        offsets.record(*exchange(offset_ns, *ways, tick * 100_000_000))
        told += [(tick, changed)] if (changed := offsets.take_change()) is not None else []
    ((at, (before, now)),) = told
    assert at >= 300
    assert before.offset_s == pytest.approx(1.0, abs=before.uncertainty_s)
    assert now.offset_s == pytest.approx(1.0 + step_ns * 1e-9, abs=now.uncertainty_s)


def test_a_clock_that_goes_on_and_a_line_that_becomes_longer_tell_of_no_clock() -> None:
    draw, offsets = random.Random(4), OffsetFilter(64)
    for tick in range(1200):
        at_ns = tick * 100_000_000
        further_ns = 30_000_000 if tick >= 600 else 0
        ways = (10_000_000 + further_ns + draw.randrange(3_000_000), 10_000_000 + draw.randrange(3_000_000))
        offsets.record(*exchange(10**9 + round(5e-5 * at_ns), *ways, at_ns))
        assert offsets.take_change() is None

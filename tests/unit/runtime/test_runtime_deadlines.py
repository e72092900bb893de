import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from telenano.runtime.loop.deadlines import LatenessWindow, PeriodicDeadline
from telenano.testing import VirtualClock

MS = 1_000_000


def test_a_loop_on_time_keeps_exactly_to_the_grid() -> None:
    clock = VirtualClock(start_ns=123)
    grid = PeriodicDeadline(clock.monotonic_ns(), MS)
    for step in range(1, 1001):
        clock.advance_ns(grid.deadline_ns - clock.monotonic_ns())
        assert clock.monotonic_ns() == 123 + step * MS
        assert grid.advance(clock.monotonic_ns()) == 1
    assert grid.overruns == 0


@given(st.integers(0, 10**18), st.integers(1, 10**7), st.lists(st.integers(0, 5 * 10**7), max_size=50))
def test_late_steps_move_no_deadline_and_every_missed_one_is_counted(
    start: int, period: int, durations: list[int]
) -> None:
    clock = VirtualClock(start)
    grid = PeriodicDeadline(start, period)
    passed = 0
    for duration in durations:
        # a step that takes its time, then the wait for the deadline, which is over at once when it is late
        clock.advance_ns(duration)
        clock.advance_ns(max(0, grid.deadline_ns - clock.monotonic_ns()))
        passed += grid.advance(clock.monotonic_ns())
        assert grid.deadline_ns == start + (passed + 1) * period
        assert 0 < grid.deadline_ns - clock.monotonic_ns() <= period
    assert grid.overruns == passed - len(durations)
    assert passed == (clock.monotonic_ns() - start) // period


def test_a_deadline_missed_by_less_than_a_period_is_no_overrun() -> None:
    grid = PeriodicDeadline(0, MS)
    assert (grid.advance(2 * MS - 1), grid.overruns, grid.deadline_ns) == (1, 0, 2 * MS)
    # the second by exactly one period: one was missed
    assert (grid.advance(3 * MS), grid.overruns, grid.deadline_ns) == (2, 1, 4 * MS)


def test_an_early_step_counts_as_one() -> None:
    grid = PeriodicDeadline(0, MS)
    assert (grid.advance(5), grid.deadline_ns, grid.overruns) == (1, 2 * MS, 0)


@pytest.mark.parametrize("period", [0, -1])
def test_a_period_is_positive(period: int) -> None:
    with pytest.raises(ValueError, match=f"period_ns is {period}"):
        PeriodicDeadline(0, period)


def test_quantiles_of_an_interval_and_a_new_start() -> None:
    window = LatenessWindow()
    for value in range(101):
        window.record(value * 1e-6)
    p50, p99, greatest = window.take()
    np.testing.assert_allclose([p50, p99, greatest], [50e-6, 99e-6, 100e-6], rtol=1e-12, atol=0)
    assert window.take() == (0.0, 0.0, 0.0)
    window.record(3e-6)
    assert window.take() == (3e-6, 3e-6, 3e-6)


def test_a_long_interval_keeps_its_newest_samples() -> None:
    window = LatenessWindow()
    samples = np.random.default_rng(7).exponential(50e-6, 20_000)
    samples[0] = 1.0
    for value in samples:
        window.record(float(value))
    newest = samples[-8192:]
    expected = [*np.percentile(newest, [50.0, 99.0]), newest.max()]
    np.testing.assert_allclose(window.take(), expected, rtol=1e-12, atol=0)

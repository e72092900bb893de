"""The hand's time at both halves: however late its samples are, each period counts once."""

import random

import pytest

from telenano.laws.hand_periods import RESTARTED, HandClock, no_sample, periods_to

PERIOD_NS = 1_000_000
LONGEST = 50


class Counter:
    """Counts from a first sample on."""

    def __init__(self, first_ns: int) -> None:
        self.clock, periods = periods_to(no_sample(), first_ns, PERIOD_NS, LONGEST)
        assert periods == RESTARTED

    def counted(self, sampled_ns: int) -> int:
        self.clock, periods = periods_to(self.clock, sampled_ns, PERIOD_NS, LONGEST)
        return periods


@pytest.mark.parametrize("seed", range(4))
def test_no_period_counts_twice_however_late_the_samples_are(seed: int) -> None:
    source, hand, counted, grid = random.Random(seed), Counter(10**18), 0, 0
    for _ in range(5000):
        # some samples were lost on the way, and a late one still comes before the next
        grid += source.choice((1, 1, 1, 1, 2, 5))
        late_ns = source.choice((0, 0, 0, source.randrange(999_000)))
        counted += hand.counted(10**18 + grid * PERIOD_NS + late_ns)
        assert abs(counted - grid) <= 1
    # by itself, each difference of two stamps would have been rounded: some hundred too many
    counted += hand.counted(10**18 + (grid + 1) * PERIOD_NS)
    assert counted == grid + 1


def test_a_first_sample_that_was_late_is_not_what_the_others_are_counted_by() -> None:
    source, hand = random.Random(1), Counter(10**18 + 600_000)
    stamps = [10**18 + n * PERIOD_NS + source.randrange(200_000) for n in range(1, 1000)]
    counts = [hand.counted(stamp) for stamp in stamps]
    assert set(counts[300:]) == {1}
    assert sum(counts) in (998, 999)


@pytest.mark.parametrize(
    ("later_ns", "periods"), [(50 * PERIOD_NS, 50), (51 * PERIOD_NS, RESTARTED), (0, RESTARTED), (-1, RESTARTED)]
)
def test_it_begins_anew_after_the_longest_pause_and_with_stamps_that_go_back(later_ns: int, periods: int) -> None:
    hand = Counter(10**18)
    assert hand.counted(10**18 + later_ns) == periods
    if periods == RESTARTED:
        assert hand.clock == HandClock(10**18 + later_ns, 10**18 + later_ns)


def test_what_stands_for_a_new_beginning_is_no_count() -> None:
    assert RESTARTED < 0


@pytest.mark.parametrize("first_ns", [0, 2 * PERIOD_NS, 10**18])
def test_samples_that_are_never_late_count_one_period_each_and_leave_the_grid_where_it_is(first_ns: int) -> None:
    hand = Counter(first_ns)
    for number in range(1, 4):
        assert hand.counted(first_ns + number * PERIOD_NS) == 1
        assert hand.clock == HandClock(first_ns + number * PERIOD_NS, first_ns + number * PERIOD_NS)


@pytest.mark.parametrize(
    ("since_ns", "periods", "grid_ns"),
    [
        (PERIOD_NS // 2 - 1, 0, 7812),
        (PERIOD_NS // 2, 1, PERIOD_NS - 7813),
        (PERIOD_NS + 640, 1, PERIOD_NS + 10),
        (3 * PERIOD_NS // 2 - 1, 1, PERIOD_NS + 7812),
        (3 * PERIOD_NS // 2, 2, 2 * PERIOD_NS - 7813),
    ],
)
def test_a_sample_counts_to_the_nearest_place_of_the_grid_and_moves_it_by_a_64th(
    since_ns: int, periods: int, grid_ns: int
) -> None:
    hand = Counter(10**18)
    assert hand.counted(10**18 + since_ns) == periods
    assert hand.clock == HandClock(10**18 + since_ns, 10**18 + grid_ns)

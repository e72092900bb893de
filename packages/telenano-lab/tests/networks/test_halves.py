"""The halves of a log differ where the line changed, and of lines that stay as they are in 5 % at most."""

import math

import pytest
from halves_confusion import KINDS, drawn, is_said_to_differ
from telenano_lab.networks.line_halves import compared_halves

# Correlation times of a half from which on a step by one median absolute deviation is found in nine of ten.
FOUND_FROM = 100.0


def answers(seeds: range, *, is_changed: bool, longest_s: float, fewest_times: float = 0.0) -> list[bool]:
    """Return what is said of lines of each kind, of those whose halves have this many correlation times."""
    lines = (
        drawn(seed, kind, is_changed=is_changed, longest_s=longest_s) for kind in range(len(KINDS)) for seed in seeds
    )
    return [is_said_to_differ(line) for line in lines if line.times >= fewest_times]


def most_by_chance(count: int, share: float) -> int:
    """Return the number that a share of this count passes with a probability of 1 %."""
    return math.floor(share * count + 2.33 * math.sqrt(share * (1.0 - share) * count) + 0.5)


@pytest.mark.check("takes 12 s")
def test_lines_that_stay_as_they_are_are_seldom_said_to_change_and_a_change_is_found() -> None:
    same = answers(range(5000, 5020), is_changed=False, longest_s=180.0)
    assert sum(same) <= most_by_chance(len(same), 0.05)
    changed = answers(range(6000, 6012), is_changed=True, longest_s=180.0, fewest_times=FOUND_FROM)
    assert len(changed) - sum(changed) <= most_by_chance(len(changed), 0.1)


@pytest.mark.endurance("takes 20 min")
@pytest.mark.timeout(3600)
def test_of_sixteen_hundred_lines_up_to_an_hour_long_five_in_a_hundred_are_said_to_change() -> None:
    same = answers(range(7000, 7400), is_changed=False, longest_s=3600.0)
    assert sum(same) <= most_by_chance(len(same), 0.05)
    changed = answers(range(8000, 8200), is_changed=True, longest_s=3600.0, fewest_times=FOUND_FROM)
    assert sum(changed) >= 0.9 * len(changed)


def test_a_half_without_a_loss_or_a_stall_has_no_difference_that_chance_cannot_make() -> None:
    line = drawn(3, 0, is_changed=False, longest_s=61.0)
    found = compared_halves(line.log)
    assert not found["lost"].differ
    assert found["q50 [ms]"].most_by_chance > 0.0

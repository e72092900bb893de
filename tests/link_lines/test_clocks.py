"""Clocks that run alike are seldom said to change, and a clock that is set is seen in a recording of both."""

import math

import pytest
from clocks_confusion import KINDS, drawn, said_of


def most_by_chance(count: int, share: float) -> int:
    """Return the number that a share of this count passes with a probability of 1 %."""
    return math.floor(share * count + 2.33 * math.sqrt(share * (1.0 - share) * count) + 0.5)


def said(seeds: range, change: str, longest_s: float) -> list[tuple[bool, bool]]:
    """Return whether clocks of each kind of way are said to change, by a recording and by the link."""
    found = [said_of(drawn(seed, kind, change, 1.0, longest_s)) for kind in range(len(KINDS)) for seed in seeds]
    return [(one.changed, one.changed_live) for one in found]


def check(same: range, changed: range, longest_s: float) -> None:
    alike = said(same, "none", longest_s)
    assert sum(by_recording for by_recording, _ in alike) <= most_by_chance(len(alike), 0.05)
    assert sum(by_link for _, by_link in alike) <= most_by_chance(len(alike), 0.05)
    for change in ("set", "rate"):
        found = said(changed, change, longest_s)
        assert len(found) - sum(by_recording for by_recording, _ in found) <= most_by_chance(len(found), 0.1)


@pytest.mark.check("takes 8 s")
def test_some_clocks_that_run_alike_are_not_said_to_change_and_changes_are_found() -> None:
    check(range(5000, 5010), range(6000, 6006), 120.0)


@pytest.mark.endurance("takes 8 min")
@pytest.mark.timeout(1800)
def test_of_four_hundred_clocks_that_run_alike_five_in_a_hundred_are_said_to_change() -> None:
    check(range(7000, 7100), range(8000, 8050), 600.0)

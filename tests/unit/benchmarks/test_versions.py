"""Versions of a benchmark differ where one of them is slower, and equal ones in 5 % of the comparisons at most."""

import math

import pytest
from versions_confusion import DIFFERENT, FIGURES, KINDS, drawn, said

from benchmarks.versions import compared


def most_by_chance(count: int, share: float) -> int:
    """Return the number that a share of this count passes with a probability of 1 %."""
    return math.floor(share * count + 2.33 * math.sqrt(share * (1.0 - share) * count) + 0.5)


@pytest.mark.check("takes 4 s")
def test_equal_versions_are_seldom_said_to_differ_and_one_that_is_slower_is_found() -> None:
    kinds = [(kind, seed) for kind in range(len(KINDS)) for seed in range(9000, 9080)]
    equal = [one for one in (said(seed, kind, differs=False) for kind, seed in kinds) if one.known]
    assert sum(bool(one.differ) for one in equal) <= most_by_chance(len(equal), 0.05)
    found = [one for one in (said(seed, kind, differs=True) for kind, seed in kinds) if one.known]
    assert len(found) > 0.3 * len(kinds)
    missed = sum(f"figure {DIFFERENT}" not in one.differ for one in found)
    assert missed <= most_by_chance(len(found), 0.1)


def test_few_pairs_and_pairs_that_are_all_alike_say_what_they_can() -> None:
    few = compared({"a": [(1.0, 2.0)] * 5})["a"]
    assert few.ratio == pytest.approx(0.5) and math.isnan(few.low) and not few.differs
    alike = compared({"a": [(1.0, 2.0)] * 40, "b": [(3.0, 3.0)] * 40})
    assert alike["a"].differs and not alike["b"].differs
    assert len(drawn(1, 0, differs=True)) == FIGURES

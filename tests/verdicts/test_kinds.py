"""The kinds of courses are what they say; `confusion.py` has what the judge says of them."""

import inspect

import numpy as np
import pytest
from kinds import CLASS_OF, CLASSES, KINDS, kind_course


def test_a_kind_is_one_function_of_forty_lines_at_most() -> None:
    assert len(KINDS) >= 16
    assert all(len(inspect.getsource(make).splitlines()) <= 40 for make in KINDS.values())


@pytest.mark.parametrize("kind", KINDS)
def test_a_course_of_a_kind_is_the_same_each_time_and_has_its_truth(kind: str) -> None:
    one, again = kind_course(kind, 3), kind_course(kind, 3)
    assert np.array_equal(one.tip_force_n, again.tip_force_n)
    truths = {"irregular": "goes_on", "cycle": "goes_on", "growth": "grows"}
    assert one.truth == truths.get(CLASS_OF[kind], "settles")
    assert len(one.time_s) == len(one.hand_force_n) == len(one.in_contact)


@pytest.mark.parametrize("kind", CLASSES["irregular"])
def test_an_irregular_motion_moves_by_a_tenth_of_the_hands_force_in_most_eighths_of_its_hold(kind: str) -> None:
    for seed in range(5):
        one = kind_course(kind, seed)
        first, last, force_n = one.planned[-1]
        held = one.tip_force_n[(one.time_s > first) & (one.time_s < last)]
        assert sum(np.ptp(part) > 0.1 * force_n for part in np.array_split(held, 8)) >= 7

"""The kinds of courses are what they say, and the judge tells a part of them; `confusion.py` has the whole."""

import inspect

import confusion
import numpy as np
import pytest
from confusion import answer
from judge import judge_course
from kept_sessions import judged, kept, names
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


@pytest.mark.check("judges four courses of each kind")
@pytest.mark.parametrize("kind", KINDS)
def test_few_courses_of_a_kind_are_judged_wrongly(kind: str) -> None:
    answers = [answer(judge_course, kind_course(kind, seed)) for seed in range(4)]
    assert sum(confusion.false_alarm(one) or confusion.missed_swing(one) for one in answers) == 0, answers
    # Nothing can be said where the hold shows too little of a way.
    assert kind == "begun_way" or sum(one.kind == "cannot_say" for one in answers) <= 2, answers


@pytest.mark.check("runs sessions of the product in lockstep, and judges them")
@pytest.mark.drawn(0.05, "telenano/analysis/")
@pytest.mark.parametrize("name", names())
def test_a_change_of_the_judge_turns_no_verdict_on_a_session_unseen(name: str) -> None:
    now, before = judged(name), kept()[name]
    assert now["verdict"] == before["verdict"]
    assert now["sizes_n"] == pytest.approx(before["sizes_n"], rel=1e-2, abs=1e-3)


def test_no_kept_session_that_moves_without_noise_is_stable() -> None:
    for name, one in kept().items():
        if name.split()[3] == "ideal" and min(one["sizes_n"]) > 0.1:  # type: ignore[call-overload]
            assert one["verdict"] != "stable", name

"""The project's judge on a part of the labelled courses; the whole is `python tests/verdicts/confusion.py`."""

import confusion
import pytest
from confusion import answer
from courses import course
from judge import judge_course

# as many courses as a few seconds of a processor judge
PART = range(60)


def shares(seeds: range, courses: str = "linear") -> dict[str, confusion.Share]:
    answers = [answer(judge_course, make(seed)) for make in confusion.COURSES[courses] for seed in seeds]
    return {one.name: one for one in confusion.limited_shares(answers)}


@pytest.mark.check("takes 2.0 s")
def test_no_course_of_a_part_is_said_to_do_what_it_does_not() -> None:
    found = shares(PART)
    assert not found["settling called a cycle or growth"].such
    assert not found["growing or going on called stable"].such


# courses outside of the corpus that were once said to do what they do not: by a kink where the hand lets go, friction
# that stops, a step of a read-out, a hand that trembles more and more, a swing or a tip that leaves the surface, a
# slow growth to one side
ONCE_WRONG = (
    20045,
    20233,
    21120,
    21229,
    21644,
    22154,
    22731,
    24237,
    25435,
    25622,
    42085,
    42531,
    42801,
    60098,
    60414,
    60789,
)


@pytest.mark.parametrize("seed", ONCE_WRONG)
def test_a_course_that_was_once_judged_wrongly_is_not_again(seed: int) -> None:
    said = answer(judge_course, course(seed))
    assert not confusion.false_alarm(said) and not confusion.missed_swing(said), said


@pytest.mark.check("judges a hundred and fifty labelled courses, takes 10 s")
def test_few_courses_are_judged_wrongly() -> None:
    found = shares(range(75), "all")
    # of fifty that settle, and of thirty that grow or go on, one is more than the limits have in the mean
    assert not found["settling called a cycle or growth"].such
    assert len(found["growing or going on called stable"].such) <= 1
    assert found["cannot say of a growth or cycle of four turns"].value < 0.16


@pytest.mark.endurance("takes 5 min")
@pytest.mark.parametrize("courses", ["linear", "nonlinear"])
def test_of_thousands_of_courses_few_are_judged_wrongly(courses: str) -> None:
    """The limits of three standard deviations above what was measured on seeds that were seen once."""
    found = shares(range(1500), courses)
    assert found["settling called a cycle or growth"].value <= 0.009
    assert found["growing or going on called stable"].value <= 0.015
    assert found["cannot say of what is at rest"].value <= 0.045
    assert found["cannot say of a growth or cycle of four turns"].value <= 0.08

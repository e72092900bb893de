"""When the link asks the other site for its time: a question that is due is sent, or is due later."""

import random

import pytest

from telenano.link.ping_times import NEVER_NS, Questions

MS = 1_000_000
ROUND_TRIP_NS = 20 * MS


def acted(seed: int) -> Questions:
    """Return questions after answers, messages and turns in an order of a seed, each turn taken when it was due."""
    dice, questions, now_ns = random.Random(seed), Questions(), 1_000 * MS
    for _ in range(300):
        now_ns += dice.choice([0, 100_000, 4 * MS, 9 * MS, 60 * MS])
        match dice.choice(["ask", "answer", "hear", "turn", "turn"]):
            case "ask":
                questions.ask(now_ns)
            case "answer":
                questions.answer(now_ns, in_doubt=dice.random() < 0.5, is_longer=dice.random() < 0.3)
            case "hear":
                questions.hear(now_ns)
            case "turn" if questions.due_ns(ROUND_TRIP_NS) <= now_ns:
                if questions.take(now_ns, ROUND_TRIP_NS):
                    questions.ask(now_ns)
                assert questions.due_ns(ROUND_TRIP_NS) > now_ns, (seed, questions)
    return questions


def test_after_the_turn_in_which_it_was_due_a_question_is_due_later() -> None:
    # the loop of the link would otherwise take turn after turn, and nothing else
    ended = [acted(seed) for seed in range(200)]
    assert any(one.until_ns for one in ended)


@pytest.mark.parametrize("late_ns", [0, 1, 5 * MS])
def test_a_series_that_has_ended_before_its_next_question_is_over(late_ns: int) -> None:
    questions = Questions(answers=1)
    questions.ask(0)
    begun_ns = questions.due_ns(ROUND_TRIP_NS)
    assert questions.take(begun_ns, ROUND_TRIP_NS)
    questions.answer(begun_ns + 5 * MS, in_doubt=False, is_longer=True)
    assert not questions.take(begun_ns + 10 * MS + late_ns, ROUND_TRIP_NS)
    assert questions.due_ns(ROUND_TRIP_NS) == NEVER_NS

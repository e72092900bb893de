"""The verdicts on two hundred courses are those that are kept beside the test."""

import pytest
from kept_verdicts import is_same, kept, verdicts


def test_sentences_are_compared_by_words_and_numbers() -> None:
    assert is_same("dies out by 0.054/s, 2 N are left", "dies out by 0.0541/s, 2 N are left")
    assert not is_same("dies out by 0.054/s", "dies out by 0.056/s")
    assert not is_same("dies out by 0.054/s", "grows by 0.054/s")


@pytest.mark.check("judges two hundred courses, takes 15 s")
def test_a_change_of_the_judge_turns_no_verdict_unseen() -> None:
    before, now = kept(), verdicts()
    assert now.keys() == before.keys()
    turned = [
        f"{name}: {kind} ({reason}), and before {before[name][0]} ({before[name][1]})"
        for name, (kind, reason) in now.items()
        if kind != before[name][0] or not is_same(reason, before[name][1])
    ]
    assert not turned, "\n".join(["python tests/verdicts/kept_verdicts.py keeps these:", *turned])

"""The comparison counts what a judge says as it is stated, for judges whose answers are known."""

import confusion
import distribution as d
import pytest
from confusion import Answer
from courses import Course, course

SEEDS = range(120)
KIND_OF = {"settles": "settling", "grows": "diverged", "goes_on": "limit_cycle", "no_truth": "cannot_say"}


TRUTHS = {one.tip_force_n.tobytes(): one.truth for one in map(course, SEEDS)}


def truth_of(recorded: Course) -> str:
    """Return the truth of a course by its samples, since a judge does not receive it."""
    return TRUTHS[recorded.tip_force_n.tobytes()]


def oracle(recorded: Course) -> tuple[str, str]:
    return KIND_OF[truth_of(recorded)], "a longer hold would decide it"


@pytest.fixture(scope="module")
def recorded() -> list[Course]:
    return [course(seed) for seed in SEEDS]


def shares(judge: confusion.Judge, recorded: list[Course]) -> dict[str, confusion.Share]:
    answers = [confusion.answer(judge, one) for one in recorded]
    return {one.name: one for one in confusion.limited_shares(answers) + confusion.other_shares(answers)}


def test_a_judge_that_knows_the_truth_is_within_every_limit(recorded: list[Course]) -> None:
    assert all(not one.such and not one.too_large for one in shares(oracle, recorded).values())


@pytest.mark.parametrize(
    ("kind", "above", "below"),
    [
        ("stable", "growing or going on called stable", "settling called a cycle or growth"),
        ("limit_cycle", "settling called a cycle or growth", "growing or going on called stable"),
        ("diverged", "settling called a cycle or growth", "cannot say"),
        ("cannot_say", "cannot say", "settling called a cycle or growth"),
        ("no_data", "cannot say", "growing or going on called stable"),
    ],
)
def test_a_judge_with_one_word_is_above_the_limit_of_that_word(
    recorded: list[Course], kind: str, above: str, below: str
) -> None:
    counted = shares(lambda _: (kind, "because"), recorded)
    assert counted[above].value == 1.0
    assert counted[above].too_large
    assert not counted[below].such


def test_a_judge_does_not_receive_the_truth(recorded: list[Course]) -> None:
    received: list[Course] = []

    def judge(one: Course) -> tuple[str, str]:
        received.append(one)
        return "stable", "because"

    answers = [confusion.answer(judge, one) for one in recorded]
    hidden = ("truth", "rate_per_s", "frequency_hz", "tags", "cell", "seed")
    assert {tuple(getattr(one, name) for name in hidden) for one in received} == {
        ("no_truth", 0.0, 0.0, frozenset(), "", 0)
    }
    assert [one.seed for one in answers] == list(SEEDS)
    assert all(one.time_s is given.time_s for one, given in zip(received, recorded, strict=True))


def test_guarded_without_a_withdrawal_says_nothing(recorded: list[Course]) -> None:
    counted = shares(lambda _: ("guarded", "the guard withdrew"), recorded)
    known = [one for one in recorded if one.truth != "no_truth"]
    assert counted["cannot say"].such == [one.seed for one in known if one.guard is None]
    assert len(counted["cannot say"].such) < len(known)


def test_cannot_say_needs_a_reason_also_where_there_is_no_truth(recorded: list[Course]) -> None:
    counted = shares(lambda one: (KIND_OF[truth_of(one)], " "), recorded)["cannot say without a reason"]
    assert counted.too_large
    assert counted.such == [one.seed for one in recorded if one.truth == "no_truth"]


def test_courses_without_a_truth_are_in_no_share_and_no_cell(recorded: list[Course]) -> None:
    answers = [confusion.answer(oracle, one) for one in recorded]
    assert sum(len(there) for there in confusion.cells(answers).values()) == len(confusion.known(answers))
    assert all(one.truth != "no_truth" for there in confusion.cells(answers).values() for one in there)


def made(seed: int, cell: str, kind: str) -> Answer:
    return Answer(seed, "settles", kind, confusion.FAMILIES[kind], "because", cell, frozenset())


def test_rare_cells_are_judged_together() -> None:
    full = [made(seed, "fast/high/long", "stable") for seed in range(d.LEAST_IN_A_CELL)]
    rare = [made(100, "slow/low/short", "cannot_say"), made(101, "slow/high/short", "stable")]
    assert {cell: len(there) for cell, there in confusion.cells(full + rare).items()} == {
        "fast/high/long": d.LEAST_IN_A_CELL,
        "all rare cells": 2,
    }
    above = {one.name for one in confusion.limited_shares(full + rare) if one.too_large}
    assert above == {"cannot say", "cannot say in all rare cells"}


def test_a_share_at_its_limit_is_not_above_it() -> None:
    assert not confusion.Share("", [1], 10, 0.1).too_large
    assert confusion.Share("", [1, 2], 10, 0.1).too_large
    assert confusion.Share("", [], 0, 0.1).value == 0.0


def test_an_unknown_kind_is_named(recorded: list[Course]) -> None:
    with pytest.raises(ValueError, match="course 0: the judge says 'drifting', and not one of stable, settling"):
        confusion.answer(lambda _: ("drifting", ""), recorded[0])


def test_the_command_prints_the_table_and_ends_with_what_it_found(capsys: pytest.CaptureFixture[str]) -> None:
    assert confusion.main(["--courses", "linear", "--seeds", "0:40"], oracle) == 0
    printed = capsys.readouterr().out
    assert "ABOVE" not in printed
    assert "goes_on" in printed
    assert confusion.main(["--courses", "linear", "--seeds", "0:40"], lambda _: ("limit_cycle", "")) == 1
    printed = capsys.readouterr().out
    wrong = [seed for seed in range(40) if course(seed).truth == "settles"]
    assert f"settling called a cycle or growth, {len(wrong)}: {' '.join(map(str, wrong))}" in printed
    assert "ABOVE ITS LIMIT" in printed


@pytest.mark.parametrize("seeds", ["5", "a:b", "3:3", "-2:4"])
def test_seeds_that_are_no_range_are_refused(seeds: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        confusion.main([f"--seeds={seeds}"], oracle)
    assert "FIRST" in capsys.readouterr().err

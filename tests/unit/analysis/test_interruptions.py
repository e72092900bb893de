"""Interruptions of the loop from what a device reported, and what is said of them."""

import numpy as np
import pytest

from telenano.analysis.interruptions import DEADLINE, Interruption, InterruptionKind, ModeReport, in_words
from telenano.analysis.interruptions import interruptions_of as found_in

TIME_S = np.arange(1000) * 1e-2
STARVED = "no command within the deadline of 50 ms"


def open_in(*spans: tuple[float, float]) -> np.ndarray:
    inside = [(begin - 1e-9 <= TIME_S) & (end - 1e-9 > TIME_S) for begin, end in spans]
    return np.any(inside, axis=0) if spans else np.zeros(len(TIME_S), dtype=bool)


def spans_of(
    kind: InterruptionKind,
    *spans: tuple[float, float],
    reports: tuple[ModeReport, ...] = (),
    restarts: tuple[int, ...] = (),
) -> list[tuple[float, float]]:
    found = found_in(kind, TIME_S, open_in(*spans), reports, restarts)
    return [(round(one.start_s, 6), round(one.end_s, 6)) for one in found]


def test_each_stretch_without_commands_is_one_from_its_first_sample_to_the_first_that_follows_again() -> None:
    assert spans_of("tip_held", (2.0, 2.3), (5.0, 5.01)) == [(2.0, 2.3), (5.0, 5.01)]
    # One that lasts to the end of a series ends with its last sample.
    assert spans_of("tip_held", (9.5, 20.0)) == [(9.5, 9.99)]
    assert spans_of("tip_held") == []


def test_a_device_that_began_held_or_was_restarted_was_not_interrupted() -> None:
    assert spans_of("tip_held", (0.0, 1.0), (0.01 + 1.0, 2.0)) == [(1.01, 2.0)]
    assert spans_of("tip_held", (3.0, 3.5), (6.0, 6.5), restarts=(300,)) == [(6.0, 6.5)]
    # A process that came back within a stretch or after it does not excuse what came before.
    assert spans_of("tip_held", (3.0, 3.5), restarts=(299, 301, 350)) == [(3.0, 3.5)]


@pytest.mark.parametrize(
    ("late_s", "is_told"), [(-0.21, False), (-0.19, True), (0.0, True), (0.19, True), (0.21, False)]
)
def test_the_reason_is_that_of_a_report_within_a_fifth_of_a_second(late_s: float, is_told: bool) -> None:
    reports = [ModeReport(4.0 + late_s, "held", "asked_for")]
    (hand,) = found_in("hand_let_go", TIME_S, open_in((4.0, 4.5)), reports)
    assert hand.reason == ("asked_for" if is_told else "")
    # A tip that was held because somebody asked for it was not interrupted; where nobody told why, commands lacked.
    tip = found_in("tip_held", TIME_S, open_in((4.0, 4.5)), reports)
    assert [one.reason for one in tip] == ([] if is_told else [DEADLINE])


def test_of_two_reports_the_nearer_one_has_the_reason() -> None:
    reports = [
        ModeReport(3.85, "held", "asked_for"),
        ModeReport(4.1, "held", DEADLINE),
        ModeReport(9.0, "held", "late"),
    ]
    for ordered in (reports, reports[::-1]):
        (one,) = found_in("tip_held", TIME_S, open_in((4.0, 4.5)), ordered)
        assert (one.kind, one.reason) == ("tip_held", DEADLINE)
    assert found_in("tip_held", TIME_S, open_in((3.9, 4.5)), reports) == []


def test_a_device_is_starved_where_its_commands_did_not_come() -> None:
    assert Interruption("tip_held", 1.0, 2.0, DEADLINE).starved
    assert Interruption("hand_let_go", 1.0, 2.0, STARVED).starved
    assert not Interruption("hand_let_go", 1.0, 2.0, "the limit of the speed").starved
    assert not Interruption("process_ended", 1.0, 2.0, "controller@slave ended").starved


def one(kind: InterruptionKind, start_s: float, length_s: float, reason: str = "") -> Interruption:
    return Interruption(kind, start_s, start_s + length_s, reason)


@pytest.mark.parametrize(
    ("kind", "reason"),
    [("tip_held", DEADLINE), ("hand_let_go", STARVED), ("source_silent", "afm/state was silent")],
)
def test_the_first_time_the_number_and_the_longest_are_said(kind: InterruptionKind, reason: str) -> None:
    single = in_words([one(kind, 1.2345, 0.1, reason)])
    assert "1.234 s" in single or "1.235 s" in single
    assert "100 ms" in single or "1.334 s" in single or "1.335 s" in single
    assert "times" not in single and "longest" not in single and "first" not in single
    several = in_words([one(kind, 1.5, 0.1, reason), one(kind, 3.0, 0.25, reason), one(kind, 5.0, 0.2, reason)])
    assert " 3 times" in several and several.partition(", first ")[2].startswith(
        "at 1.500 s, for 250 ms at the longest"
    )
    assert reason in single and reason in several


def test_a_process_that_ended_is_said_with_the_number_of_the_others() -> None:
    ended = [
        one("process_ended", at_s, 0.5, f"{node} ended") for at_s, node in ((2.0, "a@b"), (3.0, "c@d"), (4.0, "e@f"))
    ]
    assert in_words(ended[:1]) == "at 2.000 s a@b ended"
    assert in_words(ended) == "at 2.000 s a@b ended, and 2 more processes of the rig ended"


def test_each_kind_and_each_silent_source_has_a_clause_of_its_own_and_the_cause_comes_first() -> None:
    both = [
        one("hand_let_go", 1.4, 0.1, STARVED),
        one("source_silent", 1.2, 0.1, "x was silent"),
        one("source_silent", 1.3, 0.1, "y was silent"),
        one("source_silent", 2.2, 0.3, "x was silent"),
        one("tip_held", 1.3, 0.1, DEADLINE),
        one("process_ended", 1.1, 0.1, "a@b ended"),
    ]
    first, silent, other, tip, hand = in_words(both).split("; ")
    assert "a@b ended" in first
    assert silent == "x was silent 2 times, first at 1.200 s, for 300 ms at the longest"
    assert other == "y was silent from 1.300 s to 1.400 s"
    assert "the tip was held once" in tip and "the hand was let go once" in hand
    assert in_words([]) == ""


def test_a_hand_that_was_let_go_for_several_reasons_is_said_with_the_most_frequent_one() -> None:
    reasons = ("too fast", STARVED, STARVED)
    found = [one("hand_let_go", 1.0 + n, 0.1, reason) for n, reason in enumerate(reasons)]
    assert STARVED in in_words(found) and "too fast" not in in_words(found)
    assert "(" not in in_words([one("hand_let_go", 1.0, 0.1)])

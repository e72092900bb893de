"""Phases of a session, made up and recorded."""

from pathlib import Path

import numpy as np
import pytest
from made_sessions import Made

import telenano
from telenano.analysis.phases import contacts_of, moments_of, phases_of
from telenano.analysis.recording_document import judged_recording, summary_facts
from telenano.api import RecordedSession
from telenano.recording.multi_file import open_recordings

TIME_S = np.arange(0.0, 8.0, 0.001)


def contact(*spans: tuple[float, float]) -> np.ndarray:
    return np.any([(begin <= TIME_S) & (end > TIME_S) for begin, end in spans], axis=0)


def test_a_tip_that_bounces_when_it_lands_has_one_contact() -> None:
    found = contacts_of(TIME_S, contact((2.0, 2.004), (2.010, 5.0), (6.0, 8.0)))
    assert [pytest.approx(span, abs=2e-3) for span in found] == [(2.0, 5.0), (6.0, 8.0)]
    assert contacts_of(TIME_S, np.zeros(TIME_S.size, dtype=bool)) == []
    # the last one lasts to the end, where nothing was lost
    assert [moment.kind for moment in moments_of(found, 8.0)] == ["contact", "lost", "contact"]


def test_the_phases_follow_one_another_from_the_beginning_to_the_end() -> None:
    force = np.interp(TIME_S, [0.8, 1.2, 4.5, 4.6], [0.0, 1.0, 1.0, 0.0])
    holds = [{"start_s": 0.0, "end_s": 0.8, "hand_force_n": 0.0}, {"start_s": 2.5, "end_s": 4.5, "hand_force_n": 1.0}]
    found = phases_of(TIME_S, force, contacts_of(TIME_S, contact((2.0, 5.0))), holds, 8.0)
    assert [span.kind for span in found] == ["apart", "approach", "contact", "hold", "release", "released"]
    assert [span.to_s for span in found[:-1]] == [span.from_s for span in found[1:]]
    assert (found[0].from_s, found[-1].to_s) == (0.0, 8.0)


def test_a_hold_during_which_the_tip_lands_is_one_phase() -> None:
    force = np.full(TIME_S.size, 1.0)
    holds = [{"start_s": 1.0, "end_s": 4.0, "hand_force_n": 1.0}]
    found = phases_of(TIME_S, force, [(2.0, 8.0)], holds, 8.0)
    assert [span.kind for span in found if span.kind == "hold"] == ["hold"]


def test_a_hand_that_does_nothing_has_no_phases_but_one() -> None:
    assert [span.kind for span in phases_of(TIME_S, np.zeros(TIME_S.size), [], [], 8.0)] == ["apart"]


@pytest.mark.parametrize(("gap_s", "count"), [(0.018, 1), (0.022, 2)])
def test_a_tip_that_is_off_for_a_fiftieth_of_a_second_is_still_in_contact(gap_s: float, count: int) -> None:
    found = contacts_of(TIME_S, contact((2.0, 3.0), (3.0 + gap_s, 4.0), (4.0 + gap_s, 5.0)))
    assert len(found) == 2 * count - 1
    assert (found[0][0], found[-1][1]) == (pytest.approx(2.0, abs=1e-3), pytest.approx(5.0, abs=1e-3))


def test_a_contact_ends_where_the_tip_is_off_and_a_last_one_with_the_samples() -> None:
    times = np.array([-1.0, 0.0, 0.02, 0.5, 1.0])
    assert contacts_of(times, np.array([True, False, True, True, True])) == [(-1.0, 0.0), (0.02, 1.0)]
    assert contacts_of(times, np.array([False, True, True, False, False])) == [(0.0, 0.5)]


def test_a_tip_that_comes_off_five_milliseconds_before_the_end_is_not_said_to() -> None:
    assert [moment.kind for moment in moments_of([(-1.0, 0.0)], 0.005)] == ["contact"]
    assert [moment.kind for moment in moments_of([(-1.0, -1e-9)], 0.005)] == ["contact", "lost"]


def test_moments_are_at_both_ends_of_a_contact_but_not_at_the_end_of_the_session() -> None:
    def kinds(off_s: float) -> list[tuple[str, float]]:
        return [(moment.kind, moment.time_s) for moment in moments_of([(2.0, off_s)], 8.0)]

    assert kinds(7.994) == [("contact", 2.0), ("lost", 7.994)]
    assert kinds(7.996) == kinds(8.0) == [("contact", 2.0)]


def kinds_of(
    force_n: np.ndarray, *spans: tuple[float, float], holds: tuple[tuple[float, float, float], ...] = ()
) -> str:
    """Return the phases with their ends [s], rounded."""
    made = [{"start_s": begin_s, "end_s": end_s, "hand_force_n": held_n} for begin_s, end_s, held_n in holds]
    found = phases_of(TIME_S, force_n, list(spans), made, 8.0)
    assert [span.to_s for span in found[:-1]] == [span.from_s for span in found[1:]]
    return " ".join(f"{span.kind} {span.to_s:.1f}" for span in found)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_hand_has_begun_to_press_from_a_fiftieth_of_its_greatest_force(sign: float) -> None:
    # 0.015 N are less than that of 1 N, and 0.025 N are more.
    force = sign * np.interp(TIME_S, [1.0, 1.001, 2.0, 2.001, 3.0, 4.0], [0.0, 0.015, 0.015, 0.025, 0.025, 1.0])
    assert kinds_of(force, (5.0, 8.0)) == "apart 2.0 approach 5.0 contact 8.0"
    assert kinds_of(0.5 * force, (5.0, 8.0)) == "apart 2.0 approach 5.0 contact 8.0"
    assert kinds_of(0.0 * force, (5.0, 8.0)) == "apart 5.0 contact 8.0"
    first_s = float(TIME_S[np.abs(force) > 0.02][0])
    assert phases_of(TIME_S, force, [(5.0, 8.0)], [], 8.0)[0].to_s == first_s


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_hold_with_a_twentieth_of_the_greatest_force_is_one(sign: float) -> None:
    force = sign * np.interp(TIME_S, [1.0, 1.1, 5.0, 5.1], [0.0, 0.06, 0.06, 1.0])
    touched = (1.0, 8.0)
    assert kinds_of(force, touched, holds=((2.0, 4.0, sign * 0.06),)) == "apart 1.0 contact 2.0 hold 4.0 release 8.0"
    assert kinds_of(force, touched, holds=((2.0, 4.0, sign * 0.04),)) == "apart 1.0 contact 8.0"
    # A hand of ten times the force has begun to press, and to hold, as early.
    found = kinds_of(10.0 * force, touched, holds=((2.0, 4.0, sign * 0.6),))
    assert found == "apart 1.0 contact 2.0 hold 4.0 release 8.0"
    assert kinds_of(10.0 * force, touched, holds=((2.0, 4.0, sign * 0.4),)) == "apart 1.0 contact 8.0"


def test_a_tip_that_comes_off_before_the_last_contact_approaches_again_and_after_it_is_released() -> None:
    force = np.where(TIME_S > 0.5, 1.0, 0.0)
    held = ((2.5, 3.0, 1.0), (4.5, 5.0, 1.0))
    expected = "apart 0.5 approach 1.0 contact 2.5 hold 3.0 contact 3.5 approach 4.0 contact 4.5 hold 5.0"
    found = kinds_of(force, (1.0, 3.5), (4.0, 6.0), (6.5, 7.0), holds=held)
    assert found == f"{expected} release 6.0 approach 6.5 release 7.0 released 8.0"


def test_two_holds_side_by_side_are_two_and_what_lasts_milliseconds_is_no_phase() -> None:
    force = np.where(TIME_S > 0.5, 1.0, 0.0)
    two = kinds_of(force, (1.0, 8.0), holds=((2.0, 3.0, 1.0), (3.0, 4.0, 0.9)))
    assert two == "apart 0.5 approach 1.0 contact 2.0 hold 3.0 hold 4.0 release 8.0"
    found = phases_of(TIME_S, force, [(1.0, 2.996)], [{"start_s": 3.0, "end_s": 8.0, "hand_force_n": 1.0}], 8.0)
    assert [span.kind for span in found] == ["apart", "approach", "contact", "hold"]
    found = phases_of(TIME_S, force, [(1.0, 2.994)], [{"start_s": 3.0, "end_s": 8.0, "hand_force_n": 1.0}], 8.0)
    assert [span.kind for span in found] == ["apart", "approach", "contact", "released", "hold"]


@pytest.mark.check("takes 0.5 s")
def test_a_recording_is_judged_as_its_report_is(tmp_path: Path) -> None:
    found = judged_recording(open_recordings([Made().write(tmp_path)]))
    assert found["summary"]["verdict"]
    assert len(found["holds"]) > 0
    assert found["phases"][0]["from_s"] == pytest.approx(found["session_s"][0])
    times = [moment["t_s"] for moment in found["moments"]]
    assert times == sorted(times)


@pytest.mark.check("takes 1 s")
def test_a_summary_that_was_kept_beside_a_recording_says_what_the_judge_says(tmp_path: Path) -> None:
    path = Made().write(tmp_path)
    assert telenano.open(path).summary["verdict"]
    kept = RecordedSession([path])
    assert kept.is_judged and kept.start_ns is not None
    recording = open_recordings([path])
    found = summary_facts(kept.summary, (kept.start_ns - recording.span_ns[0]) * 1e-9)
    judged = judged_recording(recording)
    assert found["holds"] == judged["holds"]
    assert found["interruptions"] == judged["interruptions"]
    assert found["session_s"] == pytest.approx(judged["session_s"])
    assert found["summary"]["verdict"] == judged["summary"]["verdict"]


def test_a_recording_without_a_programme_says_why_it_has_no_verdict(tmp_path: Path) -> None:
    made = Made(without=lambda topic, time_s: topic == "haptic/state")
    found = judged_recording(open_recordings([made.write(tmp_path)]))
    assert found["summary"] is None
    assert "haptic/state" in found["fault"]

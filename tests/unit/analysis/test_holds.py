"""Holds of a session that is made up: what the hand does is known, and so is what becomes of the motion."""

import numpy as np
import pytest

from analysis.holds import (
    _WORST_FIRST,
    SETTLING_SHARE,
    Guard,
    Instrument,
    Limits,
    Programme,
    constant_stretches,
    guard_of,
    judge_holds,
    verdict_of,
)
from analysis.verdict import KINDS

TIME_S = np.arange(9000) * 1e-3
# at rest, pressed with 1 N, pressed with 2 N; the steps between them are ramps of half a second
HAND_N = np.interp(TIME_S, [0.0, 1.0, 1.5, 4.5, 5.0, 9.0], [0.0, 0.0, 1.0, 1.0, 2.0, 2.0])


def swing(start_s: float, end_s: float, growth_per_s: float, size_n: float) -> np.ndarray:
    """A swing of 5 Hz in a part of the session, of `size_n` where that part begins."""
    since_s = TIME_S - start_s
    inside = (since_s >= 0.0) & (end_s > TIME_S)
    return np.where(inside, size_n * np.exp(growth_per_s * since_s) * np.sin(10.0 * np.pi * since_s), 0.0)


def verdicts(tip_n: np.ndarray) -> list[str]:
    return [hold.verdict for hold in judge_holds(TIME_S, HAND_N, TIME_S, tip_n)]


def test_the_holds_are_where_the_hand_stands_still() -> None:
    found = constant_stretches(TIME_S, HAND_N, 0.01)
    assert [(round(a, 1), round(b, 1)) for a, b in found] == [(0.0, 1.0), (1.5, 4.5), (5.0, 9.0)]


def test_a_loop_that_follows_is_stable_in_each_of_them() -> None:
    holds = judge_holds(TIME_S, HAND_N, TIME_S, HAND_N)
    assert [hold.verdict for hold in holds] == ["stable"] * 3
    assert [hold.hand_force_n for hold in holds] == pytest.approx([0.0, 1.0, 2.0], abs=1e-9)


def test_a_swing_that_dies_out_grows_or_goes_on() -> None:
    assert verdicts(HAND_N + swing(1.5, 4.5, -2.0, 0.5)) == ["stable", "stable", "stable"]
    assert verdicts(HAND_N + swing(1.5, 4.5, 2.0, 0.01)) == ["stable", "diverged", "stable"]
    assert verdicts(HAND_N + swing(5.0, 9.0, 0.0, 0.3)) == ["stable", "stable", "limit_cycle"]


def test_what_the_step_before_left_behind_is_not_looked_at() -> None:
    end_s = 5.0 + 0.9 * SETTLING_SHARE * 4.0
    assert verdicts(HAND_N + swing(5.0, end_s, 0.0, 1.0)) == ["stable"] * 3


@pytest.mark.parametrize(("forces", "kind"), [(1.9, "stable"), (2.1, "struck")])
def test_a_blow_belongs_to_the_hold_that_it_is_in_or_that_follows(forces: float, kind: str) -> None:
    for at_s, pressed_n, blown in ((4.7, 2.0, 2), (5.1, 2.0, 2), (1.2, 1.0, 1), (1.7, 1.0, 1)):
        tip_n = HAND_N.copy()
        tip_n[round(1e3 * at_s)] = forces * pressed_n
        found = verdicts(tip_n)
        assert found == [kind if index == blown else "stable" for index in range(3)], at_s
        session = verdict_of(judge_holds(TIME_S, HAND_N, TIME_S, tip_n))
        assert session[0] == kind


def test_small_is_measured_by_the_greatest_force_of_the_session() -> None:
    # 0.08 N from peak to peak: 8 % of the hold's own force, 4 % of the greatest
    assert verdicts(HAND_N + swing(1.5, 4.5, 0.0, 0.04)) == ["stable"] * 3
    assert verdicts(HAND_N + swing(1.5, 4.5, 0.0, 0.06)) == ["stable", "limit_cycle", "stable"]


def test_a_session_without_force_has_no_holds() -> None:
    assert judge_holds(TIME_S, np.zeros_like(TIME_S), TIME_S, HAND_N) == []
    empty = np.array([])
    assert judge_holds(empty, empty, empty, empty) == []


def instrument(following: np.ndarray | None = None, touching: np.ndarray | None = None) -> Instrument:
    yes = np.ones(len(TIME_S), dtype=bool)
    return Instrument(yes if following is None else following, HAND_N > 0.0 if touching is None else touching)


def test_a_tip_that_the_guard_tore_off_is_not_stable() -> None:
    # as the force limit does it: in the first press, and never armed again
    following = TIME_S < 1.3
    torn = np.where(following, HAND_N, 0.0)
    holds = judge_holds(TIME_S, HAND_N, TIME_S, torn, instrument(following, following & (HAND_N > 0.0)))
    assert [hold.verdict for hold in holds] == ["stable", "guarded", "guarded"]
    acted = "the instrument's guard acted at 1.300 s"
    assert verdict_of(holds) == ("guarded", f"{acted}; until then the hold has 0 samples")


LIMITS = Limits(force_n=200e-9, silence_s=0.3)


def test_a_guard_that_acted_comes_first_with_its_time_and_limit() -> None:
    # while the force grows; the hold before it is called diverged without the guard having acted in it
    following = TIME_S < 3.1
    tip = instrument(following, following & (HAND_N > 0.0))
    programme = Programme(guards=[Guard(3.12, "force_limit")], limits=LIMITS)
    growing = np.where(following, HAND_N + swing(1.5, 3.1, 2.0, 0.01), 0.0)
    holds = judge_holds(TIME_S, HAND_N, TIME_S, growing, tip, programme)
    kind, reason = verdict_of(holds, guard_of(TIME_S, tip, programme))
    assert kind == "diverged"
    limit = "(force_limit: more than 200 nN on the tip)"
    assert reason.startswith(f"the instrument's guard acted at 3.100 s {limit}; until then the motion grew")


def test_a_guard_that_acted_between_two_holds_is_not_passed_over() -> None:
    following = (TIME_S < 4.7) | (TIME_S > 4.8)
    tip = instrument(following)
    programme = Programme(guards=[Guard(4.7, "hold_expired")], limits=LIMITS)
    holds = judge_holds(TIME_S, HAND_N, TIME_S, HAND_N, tip, programme)
    assert [hold.verdict for hold in holds] == ["stable"] * 3
    kind, reason = verdict_of(holds, guard_of(TIME_S, tip, programme))
    assert kind == "guarded"
    assert reason.startswith("the instrument withdrew at 4.700 s because no command came (hold_expired: none for 300")


def test_a_guard_that_acted_before_the_programme_is_named() -> None:
    never = np.zeros(len(TIME_S), dtype=bool)
    tip = instrument(never, never)
    programme = Programme(guards=[Guard(-0.21, "force_limit")], limits=LIMITS)
    holds = judge_holds(TIME_S, HAND_N, TIME_S, np.zeros_like(TIME_S), tip, programme)
    kind, reason = verdict_of(holds, guard_of(TIME_S, tip, programme))
    assert kind == "guarded"
    assert reason.startswith("the instrument's guard acted at -0.210 s, before the hand's programme (force_limit")


def test_a_stop_that_a_person_asked_for_is_no_guard() -> None:
    following = TIME_S < 8.9
    tip = instrument(following)
    asked = Programme(guards=[Guard(8.9, "retract_requested")])
    assert guard_of(TIME_S, tip, asked) == ""
    assert guard_of(TIME_S, tip) == ""
    assert guard_of(np.array([]), Instrument(np.array([], dtype=bool), np.array([], dtype=bool))) == ""


def test_the_tip_has_to_touch_and_press_as_the_hand_does() -> None:
    assert verdict_of(judge_holds(TIME_S, HAND_N, TIME_S, HAND_N, instrument()))[0] == "stable"
    away = judge_holds(TIME_S, HAND_N, TIME_S, np.zeros_like(TIME_S), instrument(touching=np.zeros(9000, dtype=bool)))
    assert [hold.verdict for hold in away] == ["stable", "contact_lost", "contact_lost"]
    wrong = judge_holds(TIME_S, HAND_N, TIME_S, 4.0 * HAND_N, instrument())
    assert [hold.verdict for hold in wrong] == ["stable", "wrong_force", "wrong_force"]


def test_a_tip_that_meets_the_surface_late_in_a_hold_is_excused_once() -> None:
    for contact_s in (3.4, 3.6, 3.8):
        since_s = TIME_S - contact_s
        approach = np.where(since_s < 0.15, -since_s * 8.0, HAND_N - 2.2 * np.exp(-(since_s - 0.15) / 0.15))
        tip_n, touching = np.where(since_s < 0.0, 0.0, approach), since_s >= 0.0
        hold = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, instrument(touching=touching))[1]
        assert hold.verdict in ("settling", "cannot_say"), hold
        assert "met the surface" in hold.reason or "late in the hold" in hold.reason
        # one that was on the surface before, in the same hold, has been thrown off
        again = touching | ((TIME_S > 2.6) & (TIME_S < 2.7))
        thrown = np.where((TIME_S > 2.6) & (TIME_S < 2.7), 0.6 * HAND_N, tip_n)
        hold = judge_holds(TIME_S, HAND_N, TIME_S, thrown, instrument(touching=again))[1]
        assert "met the surface" not in hold.reason
    # nor is one that was on the surface in an earlier hold of the same press
    since_s = TIME_S - 8.2
    approach = np.where(since_s < 0.15, -since_s * 8.0, 2.0 - 3.2 * np.exp(-(since_s - 0.15) / 0.15))
    before = (TIME_S > 2.0) & (TIME_S < 4.0)
    tip_n = np.where(before, HAND_N, np.where(since_s < 0.0, 0.0, approach))
    hold = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, instrument(touching=before | (since_s >= 0.0)))[2]
    assert "met the surface" not in hold.reason
    hold = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, instrument(touching=since_s >= 0.0))[2]
    assert hold.verdict in ("settling", "cannot_say"), hold


def test_a_session_is_called_by_its_worst_hold() -> None:
    holds = judge_holds(TIME_S, HAND_N, TIME_S, HAND_N + swing(5.0, 9.0, 0.0, 1.0), instrument())
    assert [hold.verdict for hold in holds] == ["stable", "stable", "limit_cycle"]
    drifting = holds[1]._replace(verdict="drifting", reason="the force drifts")
    assert verdict_of([holds[0], drifting, holds[2]]) == ("limit_cycle", holds[2].reason)
    assert verdict_of([drifting, holds[0]]) == ("drifting", "the force drifts")


def test_every_verdict_has_a_place_among_the_worst() -> None:
    assert sorted(_WORST_FIRST) == sorted(KINDS)


def test_a_session_without_holds_cannot_be_called_stable() -> None:
    assert verdict_of([]) == ("cannot_say", "the hand never stood still for long enough")
    # a hand that lies on the device, as in Fig. 10, does stand still
    idle = "the hand pressed with no force, so there is no hold to judge"
    assert verdict_of([], greatest_n=0.0) == ("cannot_say", idle)


@pytest.mark.parametrize("time_constant_s", [0.3, 0.8, 2.0])
def test_a_slow_loop_that_does_not_swing_is_never_said_to(time_constant_s: float) -> None:
    # an overdamped law approaches its force; in its hold the tip has not arrived, and nothing oscillates
    tip_n = np.zeros_like(TIME_S)
    for n in range(1, len(TIME_S)):
        tip_n[n] = tip_n[n - 1] + 1e-3 / time_constant_s * (HAND_N[n] - tip_n[n - 1])
    found = judge_holds(TIME_S, HAND_N, TIME_S, tip_n)
    assert {hold.verdict for hold in found} <= {"stable", "drifting", "wrong_force"}
    assert not any("grows" in hold.reason or "neither grows" in hold.reason for hold in found)


def test_a_hold_that_lasts_into_a_scan_ends_where_the_scan_begins() -> None:
    # as of the page's hand: it keeps holding, the scan moves the tip from 3.5 s on, withdraws it, and it is armed again
    scanning, away = (3.5, 4.2), (4.2, 4.45)
    following = ~((away[0] <= TIME_S) & (away[1] > TIME_S))
    moved = (scanning[0] <= TIME_S) & (away[1] > TIME_S)
    tip_n = np.where(moved, 20.0 * np.sin(40.0 * TIME_S), HAND_N)
    tip = instrument(following)
    programme = Programme(guards=[Guard(away[0], "retract_requested")], programs=[scanning])
    holds = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, tip, programme)
    assert [hold.verdict for hold in holds] == ["stable"] * 3
    assert holds[1].end_s == scanning[0]
    assert verdict_of(holds, guard_of(TIME_S, tip, programme))[0] == "stable"
    # what the guard itself does in the same place stays what it was
    acted = programme._replace(guards=[Guard(away[0], "force_limit")], programs=[])
    assert "guard acted" in judge_holds(TIME_S, HAND_N, TIME_S, tip_n, tip, acted)[1].reason


def test_a_hold_in_which_somebody_stops_the_tip_is_judged_until_then() -> None:
    following = TIME_S < 7.0
    asked = Programme(guards=[Guard(7.0, "estop")])
    swinging = np.where(following, HAND_N + swing(5.0, 7.0, 0.0, 0.5), 0.0)
    holds = judge_holds(TIME_S, HAND_N, TIME_S, swinging, instrument(following), asked)
    assert [hold.verdict for hold in holds] == ["stable", "stable", "limit_cycle"]
    assert holds[2].end_s == 7.0
    # nobody is held by a tip that is away
    assert max(hold.end_s for hold in holds) == 7.0


def by_hand(growth_per_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the force of a person's hand and of the tip, which swing together at 0.8 Hz from 2 s on."""
    since_s = TIME_S - 2.0
    swings = np.where(since_s > 0.0, 0.8 * np.exp(growth_per_s * since_s) * np.sin(1.6 * np.pi * since_s), 0.0)
    pressed = np.interp(TIME_S, [1.0, 1.5], [0.0, 1.0])
    return pressed - 0.5 * swings, pressed + swings


@pytest.mark.parametrize(("growth_per_s", "verdict"), [(0.0, "limit_cycle"), (0.2, "diverged"), (-0.25, "stable")])
def test_a_swing_of_a_persons_hand_has_a_verdict_although_nothing_stands_still(
    growth_per_s: float, verdict: str
) -> None:
    hand_n, tip_n = by_hand(growth_per_s)
    holds = judge_holds(TIME_S, hand_n, TIME_S, tip_n, programme=Programme(by_hand=True))
    (found,) = [hold for hold in holds if hold.frequency_hz is not None]
    assert found.verdict == verdict
    assert found.frequency_hz == pytest.approx(0.8, rel=0.05)
    assert "from peak to peak at 0.8" in found.reason
    assert (found.start_s, found.end_s) == pytest.approx((1.6, 8.3), abs=0.8)
    assert verdict_of(holds)[0] == verdict
    # a programme that goes to and fro is what was asked for, and no oscillation
    assert all(hold.frequency_hz is None for hold in judge_holds(TIME_S, hand_n, TIME_S, tip_n))


def test_no_swing_is_found_in_a_hold_or_in_a_scan() -> None:
    known = Programme(by_hand=True, programs=[(5.2, 9.0)])
    tip_n = HAND_N + swing(1.5, 4.5, 0.0, 0.5) + swing(5.3, 9.0, 0.0, 3.0)
    holds = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, programme=known)
    assert [(hold.verdict, hold.frequency_hz) for hold in holds] == [("stable", None), ("limit_cycle", None)]

"""Holds of a session that is made up: what the hand does is known, and so is what becomes of the motion."""

from typing import get_args

import numpy as np
import pytest

from telenano.analysis.holds import (
    _WORST_FIRST,
    Guard,
    Incident,
    Instrument,
    Late,
    Limits,
    SessionContext,
    _landed,
    _Session,
    _without_hand,
    constant_stretches,
    episodes_of,
    guard_of,
    judge_holds,
    outside,
    verdict_of,
)
from telenano.analysis.interruptions import Interruption
from telenano.analysis.verdict import Kind

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


def test_a_hand_stands_still_for_half_a_second_at_least() -> None:
    for last, found in ((500, 1), (499, 0)):
        assert len(constant_stretches(TIME_S, np.where(np.arange(9000) <= last, 1.0, TIME_S), 0.01)) == found
    assert outside((0.0, 1.0), [(0.5, 2.0)]) == [(0.0, 0.5)]
    assert outside((0.0, 1.0), [(0.499, 2.0)]) == []


def test_a_hold_that_was_planned_is_whole_where_the_hand_trembles_in_most_of_it() -> None:
    """For a third of the time it stands still: a hold by itself, which shows less than half of what was planned."""
    hand_n = HAND_N + np.where((TIME_S > 2.5) & (TIME_S < 4.5), 0.05 * np.sin(56.0 * TIME_S), 0.0)
    for planned, ends in (([(1.5, 4.5, 1.0)], (1.5, 4.5)), ([], (1.5, 2.5))):
        hold = judge_holds(TIME_S, hand_n, TIME_S, hand_n, instrument(), SessionContext(planned=planned))[0]
        assert (hold.start_s, hold.end_s) == pytest.approx(ends, abs=0.02)


def test_a_loop_that_follows_is_stable_in_each_of_them() -> None:
    holds = judge_holds(TIME_S, HAND_N, TIME_S, HAND_N)
    # the first second, in which hand and tip do nothing, is no hold
    assert [hold.verdict for hold in holds] == ["stable"] * 2
    assert [hold.hand_force_n for hold in holds] == pytest.approx([1.0, 2.0], abs=1e-9)
    assert [hold.hold_ratio for hold in holds] == pytest.approx([1.0, 1.0], abs=1e-6)


def test_a_swing_that_dies_out_grows_or_goes_on() -> None:
    assert verdicts(HAND_N + swing(1.5, 4.5, -2.0, 0.5)) == ["stable", "stable"]
    assert verdicts(HAND_N + swing(1.5, 4.5, 2.0, 0.01)) == ["diverged", "stable"]
    assert verdicts(HAND_N + swing(5.0, 9.0, 0.0, 0.3)) == ["stable", "limit_cycle"]


@pytest.mark.check("takes 0.7 s")
@pytest.mark.parametrize(("forces", "is_struck"), [(1.9, False), (2.1, True)])
def test_a_blow_belongs_to_the_hold_that_it_is_in_or_that_follows(forces: float, is_struck: bool) -> None:
    for at_s, pressed_n, blown in ((4.7, 2.0, 1), (5.1, 2.0, 1), (1.2, 1.0, 0), (1.7, 1.0, 0)):
        tip_n = HAND_N.copy()
        tip_n[round(1e3 * at_s)] = forces * pressed_n
        found = judge_holds(TIME_S, HAND_N, TIME_S, tip_n)
        assert [hold.verdict for hold in found] == ["stable", "stable"]
        assert [hold.has("struck") for hold in found] == [is_struck and index == blown for index in range(2)], at_s


def test_small_is_measured_by_the_greatest_force_of_the_session() -> None:
    # 0.08 N from peak to peak: 8 % of the hold's own force, 4 % of the greatest
    assert verdicts(HAND_N + swing(1.5, 4.5, 0.0, 0.04)) == ["stable"] * 2
    assert verdicts(HAND_N + swing(1.5, 4.5, 0.0, 0.06)) == ["limit_cycle", "stable"]


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
    assert [hold.verdict for hold in holds] == ["guarded", "guarded"]
    assert verdict_of(holds) == ("guarded", "the instrument's guard acted at 1.300 s")


LIMITS = Limits(force_n=200e-9, silence_s=0.3)


def test_a_guard_that_acted_comes_first_with_its_time_and_limit() -> None:
    # while the force grows; the hold before it is called diverged without the guard having acted in it
    following = TIME_S < 3.1
    tip = instrument(following, following & (HAND_N > 0.0))
    context = SessionContext(guards=[Guard(3.12, "force_limit")], limits=LIMITS)
    growing = np.where(following, HAND_N + swing(1.5, 3.1, 2.0, 0.01), 0.0)
    holds = judge_holds(TIME_S, HAND_N, TIME_S, growing, tip, context)
    kind, reason = verdict_of(holds, guard_of(TIME_S, tip, context))
    assert kind == "diverged"
    limit = "(force_limit: more than 200 nN on the tip)"
    assert reason.startswith(f"the instrument's guard acted at 3.100 s {limit}; until then a motion")


def test_a_guard_that_acted_between_two_holds_is_not_passed_over() -> None:
    following = (TIME_S < 4.7) | (TIME_S > 4.8)
    tip = instrument(following)
    context = SessionContext(guards=[Guard(4.7, "hold_expired")], limits=LIMITS)
    holds = judge_holds(TIME_S, HAND_N, TIME_S, HAND_N, tip, context)
    assert [hold.verdict for hold in holds] == ["stable"] * 2
    kind, reason = verdict_of(holds, guard_of(TIME_S, tip, context))
    assert kind == "guarded"
    assert reason.startswith("the instrument withdrew at 4.700 s because no command came (hold_expired: none for 300")


def test_a_guard_that_acted_before_the_programme_is_named() -> None:
    never = np.zeros(len(TIME_S), dtype=bool)
    tip = instrument(never, never)
    context = SessionContext(guards=[Guard(-0.21, "force_limit")], limits=LIMITS)
    holds = judge_holds(TIME_S, HAND_N, TIME_S, np.zeros_like(TIME_S), tip, context)
    kind, reason = verdict_of(holds, guard_of(TIME_S, tip, context))
    assert kind == "guarded"
    assert reason.startswith("the instrument's guard acted at -0.210 s, before the hand's force profile (force_limit")


def test_a_stop_that_a_person_asked_for_is_no_guard() -> None:
    following = TIME_S < 8.9
    tip = instrument(following)
    asked = SessionContext(guards=[Guard(8.9, "retract_requested")])
    assert guard_of(TIME_S, tip, asked) == ""
    assert guard_of(TIME_S, tip) == ""
    assert guard_of(np.array([]), Instrument(np.array([], dtype=bool), np.array([], dtype=bool))) == ""


def test_a_tip_that_never_arrived_is_no_verdict_on_the_law() -> None:
    away = judge_holds(TIME_S, HAND_N, TIME_S, np.zeros_like(TIME_S), instrument(touching=np.zeros(9000, dtype=bool)))
    assert [hold.verdict for hold in away] == ["cannot_say", "cannot_say"]
    assert away[0].reason == "the tip had not reached the surface by the end of the hold: a longer hold would decide"


def test_a_tip_that_left_for_good_has_lost_its_contact_and_one_that_comes_back_moves() -> None:
    left = instrument(touching=(HAND_N > 0.0) & (TIME_S < 3.0))
    holds = judge_holds(TIME_S, HAND_N, TIME_S, np.where(TIME_S < 3.0, HAND_N, 0.0), left)
    assert holds[0].verdict == "contact_lost"
    hammering = np.clip(HAND_N + swing(1.5, 4.5, 0.0, 1.6), 0.0, None)
    hold = judge_holds(TIME_S, HAND_N, TIME_S, hammering, instrument(touching=hammering > 0.0))[0]
    assert hold.verdict == "limit_cycle"
    assert hold.judged_from_s == pytest.approx(1.5, abs=0.01)


@pytest.mark.parametrize("force_gain", [2, 3, 5, 8, 9, 10, 11, 12, 15, 20, 50, 100])
def test_a_law_is_measured_by_its_own_rest(force_gain: int) -> None:
    tip_n = HAND_N / (1.0 + 1.0 / force_gain)
    own = SessionContext(rest_force=lambda force_n: force_n / (1.0 + 1.0 / force_gain))
    for known in (own, SessionContext()):
        holds = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, instrument(), known)
        assert [hold.verdict for hold in holds] == ["stable", "stable"]
        assert not any(hold.has("off_force") for hold in holds)
        assert [hold.hold_ratio for hold in holds] == pytest.approx([1.0 + 1.0 / force_gain] * 2, rel=1e-6)
    other = SessionContext(rest_force=lambda force_n: 0.5 * tip_n[8000] / 2.0 * force_n)
    hold = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, instrument(), other)[1]
    assert (hold.verdict, hold.has("off_force")) == ("stable", True)


def test_a_hold_in_which_nothing_moves_and_a_hand_that_has_parted_say_so() -> None:
    stuck = np.where(TIME_S < 4.5, HAND_N, 1.0)
    first, second = judge_holds(TIME_S, HAND_N, TIME_S, stuck, instrument())
    assert (first.has("nothing_moved"), second.has("nothing_moved")) == (False, True)
    apart = instrument()._replace(apart_m=np.full(9000, 1.1e-3))
    (fact,) = judge_holds(TIME_S, HAND_N, TIME_S, HAND_N, apart)[0].facts
    assert (fact.kind, fact.text) == ("parted", "hand and tip parted by 1.1 mm")
    near = apart._replace(apart_m=np.full(9000, 0.9e-3))
    assert judge_holds(TIME_S, HAND_N, TIME_S, HAND_N, near)[0].facts == ()


@pytest.mark.parametrize("arrived_s", [1.6, 2.4, 3.4, 4.0])
def test_a_tip_that_meets_the_surface_late_in_a_hold_is_judged_from_then_on(arrived_s: float) -> None:
    since_s = TIME_S - arrived_s
    landing = HAND_N - 2.2 * np.exp(-np.maximum(since_s, 0.0) / 0.05)
    tip_n = np.where(since_s < 0.0, -0.3 * np.exp(np.minimum(since_s, 0.0) / 0.01), landing)
    hold = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, instrument(touching=since_s >= 0.0))[0]
    assert hold.verdict == "stable", hold
    (late,) = [fact for fact in hold.facts if fact.kind == "arrived_late"]
    assert late.value == pytest.approx(arrived_s - 1.5, abs=0.02)
    assert hold.judged_from_s == pytest.approx(arrived_s, abs=0.002)


def starved(at_s: float, length_s: float) -> SessionContext:
    """An outage of the link, which the tip notices a deadline of 50 ms later and the hand as well; 20 ms each way."""
    kinds = ("tip_held", "hand_let_go")
    why = {"tip_held": "command_deadline", "hand_let_go": "no command within the deadline"}
    ends = (at_s + 0.07, at_s + 0.02 + length_s)
    return SessionContext(
        interruptions=[Interruption(kind, *ends, why[kind]) for kind in kinds],  # type: ignore[arg-type]
        transit_s=0.04,
    )


@pytest.mark.parametrize("length_s", [0.12, 0.2])
@pytest.mark.parametrize("at_s", [1.7, 2.2, 2.9, 3.6, 4.1, 4.3])
def test_what_an_interruption_makes_the_tip_do_is_not_the_laws(at_s: float, length_s: float) -> None:
    # starved, the tip goes on as it went, and comes back with a blow
    since_s = TIME_S - at_s - 0.02
    away = np.where((since_s > 0.0) & (since_s < length_s), 9.0 * since_s, 0.0)
    back_s = np.maximum(since_s - length_s, 0.0)
    back = np.where(since_s >= length_s, 1.5 * np.exp(-9.0 * back_s) * np.cos(30.0 * back_s), 0.0)
    tip_n = HAND_N + np.where(TIME_S < 4.5, away + back, 0.0)
    hold = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, instrument(), starved(at_s, length_s))[0]
    assert hold.verdict in ("stable", "cannot_say"), hold
    assert hold.has("interrupted")
    # what goes on for seconds after that is the law's, whatever brought it about
    swinging = HAND_N + swing(1.5, 4.5, 0.0, 0.4)
    before = judge_holds(TIME_S, HAND_N, TIME_S, swinging, instrument(), starved(at_s, length_s))[0]
    assert before.verdict == "limit_cycle" and before.has("interrupted"), before


def test_the_loop_is_open_from_the_last_command_on_until_the_tip_follows_again() -> None:
    """A deadline of 50 ms and a way of 40 ms before the interruption was noticed; both ends tell of the same one."""
    session = _Session(TIME_S, HAND_N, TIME_S, HAND_N, instrument(), starved(2.2, 0.2), 2.0, 0.0, [])

    def parts(start_s: float) -> list[tuple[str, float, float]]:
        # whether the tip touches is known at the next sample
        found = [part for part in episodes_of(session, start_s, 4.5) if part.end_s - part.start_s > 1.5e-3]
        return [(part.kind, round(part.start_s, 2), round(part.end_s, 2)) for part in found]

    assert parts(1.5) == [("contact", 1.5, 2.18), ("open", 2.18, 2.42), ("contact", 2.42, 4.5)]
    assert parts(2.3) == [("open", 2.3, 2.42), ("contact", 2.42, 4.5)]
    assert parts(2.5) == [("contact", 2.5, 4.5)]


def test_of_two_reports_of_the_guard_the_nearer_one_is_the_reason() -> None:
    following = TIME_S < 3.1
    for guards, reason in (
        ([Guard(2.95, "lateral_limit"), Guard(3.11, "force_limit")], "force_limit"),
        ([Guard(3.05, "lateral_limit"), Guard(3.3, "force_limit")], "lateral_limit"),
    ):
        tip = instrument(following, following & (HAND_N > 0.0))
        hold = judge_holds(TIME_S, HAND_N, TIME_S, HAND_N, tip, SessionContext(guards=guards, limits=LIMITS))[0]
        assert hold.verdict == "guarded" and f"({reason}" in hold.reason


@pytest.mark.parametrize(("reason", "verdict"), [("force_limit", "diverged"), ("lateral_limit", "guarded")])
def test_a_motion_without_a_line_that_has_grown_to_the_force_limit_has_diverged(reason: str, verdict: str) -> None:
    """A blow of twice the size at the end of what the guard ends is growth; another limit says nothing of it."""
    following = TIME_S < 3.1
    size_n = np.where(TIME_S > 2.3, 0.6, 0.15)
    noise_n = size_n * np.sin(np.cumsum(np.random.default_rng(5).uniform(0.0, 0.6, 9000)))
    tip_n = np.where(following, HAND_N + np.where(TIME_S > 1.5, noise_n, 0.0), 0.0)
    tip = instrument(following, following & (HAND_N > 0.0))
    hold = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, tip, SessionContext(guards=[Guard(3.1, reason)], limits=LIMITS))[
        0
    ]
    assert hold.verdict == verdict, hold.reason
    assert ("until then the motion grew from 0.3 N to 1.2 N" in hold.reason) is (verdict == "diverged"), hold.reason


def test_what_happened_within_seconds_of_a_lack_of_samples_is_named_as_its_cause() -> None:
    there = (TIME_S < 2.5) | (TIME_S > 3.5)
    incidents = [Incident(at_s, f"{at_s:g}") for at_s in (-0.6, -0.4, 5.4, 5.6)]
    context = SessionContext(incidents=incidents)
    hold = judge_holds(TIME_S, HAND_N, TIME_S[there], HAND_N[there], context=context)[0]
    assert hold.verdict == "no_data"
    assert hold.reason.split("; ")[1:] == ["at -0.400 s: -0.4", "at 5.400 s: 5.4"]


def test_a_tip_has_landed_where_its_last_contact_is_long_however_short_those_before_were() -> None:
    touches = np.concatenate([np.zeros(5), np.ones(10), np.zeros(5), np.ones(100)]).astype(bool)
    assert _landed(touches) == 20
    assert _landed(touches[:35]) == 0


def test_what_follows_the_trembling_of_the_hand_is_taken_off_with_its_delay() -> None:
    tremor = 0.1 * np.sin(56.0 * TIME_S)
    tip_n = HAND_N + np.interp(TIME_S - 0.02, TIME_S, 0.8 * tremor)
    known = SessionContext(transit_s=0.04)
    session = _Session(TIME_S, HAND_N + tremor, TIME_S, tip_n, instrument(), known, 2.0, 0.0, [])
    assert float(np.ptp(_without_hand(session, 2.0, 4.0))) < 0.01 * float(np.ptp(tip_n[2000:4000]))


def test_what_was_late_at_the_end_of_a_hold_is_none_of_it() -> None:
    end_s = judge_holds(TIME_S, HAND_N, TIME_S, HAND_N)[0].end_s
    for at_s, is_late in ((end_s, False), (end_s - 0.01, True)):
        hold = judge_holds(TIME_S, HAND_N, TIME_S, HAND_N, context=SessionContext(late=[Late(at_s, 0.03)]))[0]
        assert hold.has("machine_late") is is_late


def test_a_machine_that_is_late_is_named_and_blamed() -> None:
    # 0.8 N from peak to peak, well above what is small beside 1 N
    kicks = HAND_N + swing(2.0, 2.3, 0.0, 0.4) + swing(3.3, 3.6, 0.0, 0.4) + swing(4.0, 4.4, 0.0, 0.4)
    late = SessionContext(late=[Late(2.0, 0.03), Late(3.3, 0.02), Late(4.0, 0.025)])
    hold = judge_holds(TIME_S, HAND_N, TIME_S, kicks, instrument(), late)[0]
    # what the machine brings about dies out each time
    assert (hold.verdict, hold.has("machine_late")) == ("stable", True)
    # what goes on from such a moment may have been brought about by it
    goes_on = HAND_N + swing(2.0, 4.5, 0.0, 0.4)
    hold = judge_holds(TIME_S, HAND_N, TIME_S, goes_on, instrument(), late)[0]
    assert hold.verdict == "cannot_say"
    assert "the machine was late by 30 ms, 3 times" in hold.reason
    assert judge_holds(TIME_S, HAND_N, TIME_S, kicks, instrument())[0].verdict == "limit_cycle"
    # one that is late does not take a loop at rest its verdict
    still = judge_holds(TIME_S, HAND_N, TIME_S, HAND_N, instrument(), late)[0]
    assert (still.verdict, still.has("machine_late")) == ("stable", True)


def test_contact_is_taken_from_the_force_where_nobody_measures_it() -> None:
    tip = instrument(touching=np.ones(9000, dtype=bool))._replace(knows_contact=False)
    late = np.where(TIME_S > 3.0, HAND_N, 0.0)
    hold = judge_holds(TIME_S, HAND_N, TIME_S, late, tip)[0]
    assert hold.has("contact_by_force") and hold.has("arrived_late")
    assert hold.judged_from_s == pytest.approx(3.0, abs=0.01)


def test_a_session_is_called_by_its_worst_hold() -> None:
    holds = judge_holds(TIME_S, HAND_N, TIME_S, HAND_N + swing(5.0, 9.0, 0.0, 1.0), instrument())
    assert [hold.verdict for hold in holds] == ["stable", "limit_cycle"]
    unsaid = holds[0]._replace(verdict="cannot_say", reason="a longer hold would decide")
    assert verdict_of([holds[0], unsaid, holds[1]]) == ("limit_cycle", holds[1].reason)
    # a hold of which nothing can be said is no verdict on the law
    assert verdict_of([unsaid, holds[0]]) == ("stable", holds[0].reason)
    assert verdict_of([unsaid]) == ("cannot_say", unsaid.reason)


def test_every_verdict_has_a_place_among_the_worst() -> None:
    assert sorted(_WORST_FIRST) == sorted(get_args(Kind))


def test_a_session_without_holds_cannot_be_called_stable() -> None:
    assert verdict_of([]) == (
        "cannot_say",
        "the hand never stood still for long enough: a hold of 0.5 s or more would decide",
    )
    # a hand that lies on the device, as in Fig. 10, does stand still
    idle = "the hand pressed with no force, so there is no hold to judge: one that presses would decide"
    assert verdict_of([], greatest_n=0.0) == ("cannot_say", idle)


@pytest.mark.parametrize("time_constant_s", [0.3, 0.8, 2.0])
def test_a_slow_loop_that_does_not_swing_is_never_said_to(time_constant_s: float) -> None:
    # an overdamped law approaches its force; in its hold the tip has not arrived, and nothing oscillates
    tip_n = np.zeros_like(TIME_S)
    for n in range(1, len(TIME_S)):
        tip_n[n] = tip_n[n - 1] + 1e-3 / time_constant_s * (HAND_N[n] - tip_n[n - 1])
    found = judge_holds(TIME_S, HAND_N, TIME_S, tip_n)
    assert {hold.verdict for hold in found} <= {"stable", "cannot_say"}


def test_a_hold_that_lasts_into_a_scan_ends_where_the_scan_begins() -> None:
    # as of the page's hand: it keeps holding, the scan moves the tip from 3.5 s on, withdraws it, and it is armed again
    scanning, away = (3.5, 4.2), (4.2, 4.45)
    following = ~((away[0] <= TIME_S) & (away[1] > TIME_S))
    moved = (scanning[0] <= TIME_S) & (away[1] > TIME_S)
    tip_n = np.where(moved, 20.0 * np.sin(40.0 * TIME_S), HAND_N)
    tip = instrument(following)
    context = SessionContext(guards=[Guard(away[0], "retract_requested")], programs=[scanning])
    holds = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, tip, context)
    assert [hold.verdict for hold in holds] == ["stable"] * 2
    assert holds[0].end_s == scanning[0]
    assert verdict_of(holds, guard_of(TIME_S, tip, context))[0] == "stable"
    # what the guard itself does in the same place stays what it was
    acted = context._replace(guards=[Guard(away[0], "force_limit")], programs=[])
    assert "guard acted" in judge_holds(TIME_S, HAND_N, TIME_S, tip_n, tip, acted)[0].reason


def test_a_hold_in_which_somebody_stops_the_tip_is_judged_until_then() -> None:
    following = TIME_S < 7.0
    asked = SessionContext(guards=[Guard(7.0, "estop")])
    swinging = np.where(following, HAND_N + swing(5.0, 7.0, 0.0, 0.5), 0.0)
    holds = judge_holds(TIME_S, HAND_N, TIME_S, swinging, instrument(following), asked)
    assert [hold.verdict for hold in holds] == ["stable", "limit_cycle"]
    assert holds[1].end_s == 7.0
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
    holds = judge_holds(TIME_S, hand_n, TIME_S, tip_n, context=SessionContext(by_hand=True))
    (found,) = [hold for hold in holds if hold.frequency_hz is not None]
    assert found.verdict == verdict
    assert found.frequency_hz == pytest.approx(0.8, rel=0.05)
    assert "from peak to peak at 0.8" in found.reason
    assert (found.start_s, found.end_s) == pytest.approx((1.6, 8.3), abs=0.8)
    swung = (found.start_s <= TIME_S) & (found.end_s >= TIME_S)
    assert found.hand_force_n == pytest.approx(float(hand_n[swung].mean()), rel=1e-9)
    assert verdict_of(holds)[0] == verdict
    # a programme that goes to and fro is what was asked for, and no oscillation
    assert all(hold.frequency_hz is None for hold in judge_holds(TIME_S, hand_n, TIME_S, tip_n))


def test_no_swing_is_found_in_a_hold_or_in_a_scan() -> None:
    known = SessionContext(by_hand=True, programs=[(5.2, 9.0)])
    tip_n = HAND_N + swing(1.5, 4.5, 0.0, 0.5) + swing(5.3, 9.0, 0.0, 3.0)
    holds = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, context=known)
    assert [(hold.verdict, hold.frequency_hz) for hold in holds] == [("limit_cycle", None)]


@pytest.mark.parametrize("ramp_s", [0.02, 0.1, 0.2])
def test_a_hold_ends_where_the_hand_begins_to_leave_its_force(ramp_s: float) -> None:
    """The tip follows the hand; the first hundredth of the way off is the hand's motion and not the loop's."""
    hand_n = np.interp(TIME_S, [0.0, 1.0, 1.5, 4.5, 4.5 + ramp_s], [0.0, 0.0, 1.0, 1.0, 0.0])
    hold = judge_holds(TIME_S, hand_n, TIME_S, hand_n + swing(1.5, 4.5, -2.0, 0.3), instrument())[0]
    assert (hold.start_s, hold.end_s) == (pytest.approx(1.5, abs=2e-3), pytest.approx(4.5, abs=2e-3))
    assert (hold.verdict, "grows" in hold.reason) == ("stable", False), hold.reason


@pytest.mark.parametrize("rate_per_s", [0.5, 0.8])
def test_a_swing_that_left_the_surface_is_judged_from_when_it_did_for_the_last_time(rate_per_s: float) -> None:
    """Lifting off bounds the swing to one side, so that its mean falls back while it dies out."""
    since_s = np.maximum(TIME_S - 1.5, 0.0)
    free_n = HAND_N * (1.0 + 1.6 * np.exp(-rate_per_s * since_s) * np.sin(90.0 * since_s))
    touching = (free_n > 0.0) & (TIME_S > 1.0)
    hold = judge_holds(TIME_S, HAND_N, TIME_S, np.maximum(free_n, 0.0), instrument(touching=touching))[0]
    assert hold.verdict == "stable", hold.reason
    assert f"dies out by {rate_per_s:.1f}"[:-1] in hold.reason


@pytest.mark.parametrize("growth_per_s", [1.0, 2.0])
def test_a_tip_that_has_just_left_the_surface_is_not_at_rest_there(growth_per_s: float) -> None:
    off_n = 1.06 * np.exp(growth_per_s * (TIME_S - 4.4))
    touching = (TIME_S > 1.0) & ((off_n < 1.0) | (TIME_S > 4.5))
    tip_n = np.where(touching, HAND_N - np.where(TIME_S < 4.5, off_n, 0.0), 0.0)
    hold = judge_holds(TIME_S, HAND_N, TIME_S, np.where(TIME_S > 1.5, tip_n, HAND_N), instrument(touching=touching))[0]
    assert hold.verdict == "diverged", hold.reason
    assert f"grows by {growth_per_s:.0f}/s" in hold.reason


@pytest.mark.parametrize("gain", [0.7, 1.3])
def test_a_tip_that_follows_a_hand_which_trembles_more_and_more_does_not_grow(gain: float) -> None:
    rng = np.random.default_rng(3)
    tremor = 0.02 * np.exp(1.0 * (TIME_S - 4.5)) * np.sin(56.0 * TIME_S + np.cumsum(rng.normal(0.0, 0.05, len(TIME_S))))
    hand_n = HAND_N + np.where((TIME_S > 1.5) & (TIME_S < 4.5), tremor, 0.0)
    planned = SessionContext(planned=[(1.5, 4.5, 1.0)], transit_s=0.04)
    late_n = np.interp(TIME_S - 0.013, TIME_S, gain * (hand_n - HAND_N))
    holds = judge_holds(TIME_S, hand_n, TIME_S, HAND_N + late_n, instrument(), planned)
    assert all(hold.verdict in ("stable", "cannot_say") for hold in holds), holds


@pytest.mark.parametrize(("transit_s", "kinds"), [(0.7, ["limit_cycle"]), (0.8, ["cannot_say"])])
def test_a_hold_of_less_than_four_round_trips_condemns_nothing_unless_a_guard_ended_it(
    transit_s: float, kinds: list[str]
) -> None:
    tip_n = HAND_N + swing(1.5, 4.5, 0.0, 0.3)
    known = SessionContext(transit_s=transit_s)
    hold = judge_holds(TIME_S, HAND_N, TIME_S, tip_n, instrument(), known)[0]
    assert [hold.verdict] == kinds
    assert ("round" not in hold.reason) and (hold.verdict == "limit_cycle" or "may be on its way" in hold.reason)
    # the guard acts on a motion that grows
    grows_n = HAND_N + swing(1.5, 4.5, 2.0, 0.01)
    withdrawn = instrument()
    withdrawn = withdrawn._replace(following=TIME_S < 4.0)
    known = known._replace(guards=[Guard(4.0, "force_limit")])
    assert judge_holds(TIME_S, HAND_N, TIME_S, grows_n, withdrawn, known)[0].verdict == "diverged"


def test_a_motion_that_grows_and_is_still_small_is_a_fact_of_a_rest() -> None:
    hold = judge_holds(TIME_S, HAND_N, TIME_S, HAND_N + swing(1.5, 4.5, 1.0, 0.002), instrument())[0]
    (fact,) = (one for one in hold.facts if one.kind == "grows_small")
    assert hold.verdict == "stable" and hold.rest_from_s == pytest.approx(1.5, abs=0.01)
    assert fact.value == pytest.approx(1.0, rel=0.02)
    assert "still small" in fact.text


def test_the_noise_of_a_session_is_that_of_its_free_tip() -> None:
    """Steps by chance of a tenth of the hand's force in contact, with and without the same in the free tip."""
    generator = np.random.Generator(np.random.PCG64(5))
    jumps_n = 0.2 * (np.searchsorted(np.sort(generator.uniform(1.5, 9.0, 300)), TIME_S) % 2 - 0.5)
    contact = TIME_S > 1.2
    free_n = 0.2 * (np.searchsorted(np.sort(generator.uniform(0.0, 1.0, 40)), TIME_S) % 2 - 0.5)
    kinds = []
    for tip_n in (np.where(contact, HAND_N + jumps_n, 0.0), np.where(contact, HAND_N + jumps_n, free_n)):
        tip = instrument()._replace(in_contact=contact)
        kinds.append({hold.verdict for hold in judge_holds(TIME_S, HAND_N, TIME_S, tip_n, tip)})
    assert kinds[0] == {"limit_cycle"}
    assert "limit_cycle" not in kinds[1]
